//! Measures, for each stage, how long a frame takes to end after it is cancelled, and the longest
//! time without a progress report.
//!
//! `cargo run --release --example cancel -- INPUT OUTPUT.glb [RUNS]` reconstructs and simplifies
//! INPUT once completely. Then it starts RUNS further runs, and cancels each at a later time than
//! the previous one.

use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use meniscus::files::Replace;
use meniscus::{Cancel, Cause, Error, Progress, Reconstruction, Stage};

/// A progress report: its time, its stage, and the finished fraction of the stage.
type TimedReport = (Instant, Stage, f64);

/// Reconstructs and writes a frame, and adds every progress report to `reports`.
fn run(
    input: &Path,
    output: &Path,
    cancel: &Cancel,
    reports: &Arc<Mutex<Vec<TimedReport>>>,
) -> Result<(), Error> {
    let reports = Arc::clone(reports);
    let note = move |Progress { stage, done, .. }: Progress| {
        reports.lock().expect("no thread panics").push((Instant::now(), stage, done));
    };
    let request = Reconstruction::new().simplify(0.25).cancel(cancel.clone()).progress(note);
    let prepared = request.output(output, Replace::Refuse)?;
    request.run_file(input)?.write_to(prepared).map(drop)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [input, output, runs @ ..] = &*arguments else {
        return Err("usage: cancel INPUT OUTPUT.glb [RUNS]".into());
    };
    let runs: u32 = runs.first().map_or(Ok(60), |runs| runs.parse())?;
    let (input, output) = (Path::new(input), Path::new(output));

    let reports = Arc::default();
    let start = Instant::now();
    run(input, output, &Cancel::new(), &reports)?;
    let whole = start.elapsed();
    std::fs::remove_file(output)?;
    println!("whole: {:.2} s", whole.as_secs_f64());
    // For each stage, the longest time between one of its reports and the next report, and the sum
    // of these times.
    let mut gaps: Vec<(Stage, Duration, Duration)> = Vec::new();
    let reports = std::mem::take(&mut *reports.lock().expect("no thread panics"));
    for (at, &(since, stage, _)) in reports.iter().enumerate() {
        let gap = reports.get(at + 1).map_or(start + whole, |next| next.0) - since;
        match gaps.iter_mut().find(|(other, ..)| *other == stage) {
            Some((_, longest, all)) => (*longest, *all) = (gap.max(*longest), *all + gap),
            None => gaps.push((stage, gap, gap)),
        }
    }

    let mut slowest: Vec<(Stage, Duration, f64)> = Vec::new();
    for run_number in 0..runs {
        let after = whole.mul_f64((f64::from(run_number) + 0.5) / f64::from(runs));
        let (cancel, reports) = (Cancel::new(), Arc::default());
        let cancelled = Mutex::new(None);
        let result = std::thread::scope(|scope| {
            let work = scope.spawn(|| run(input, output, &cancel, &reports).map_err(|e| e.cause()));
            std::thread::sleep(after);
            *cancelled.lock().expect("no thread panics") = Some(Instant::now());
            cancel.cancel();
            work.join().expect("the work does not panic")
        });
        let since = cancelled.into_inner()?.ok_or("never cancelled")?;
        let took = since.elapsed();
        match result {
            Err(Cause::Cancelled) => {}
            Err(other) => return Err(format!("the frame failed: {other:?}").into()),
            Ok(()) => std::fs::remove_file(output)?,
        }
        let reports = reports.lock().expect("no thread panics");
        let Some(&(_, stage, done)) = reports.iter().rfind(|(at, ..)| *at <= since) else {
            continue;
        };
        match slowest.iter_mut().find(|(other, ..)| *other == stage) {
            Some(slowest) if slowest.1 >= took => {}
            Some(slowest) => *slowest = (stage, took, done),
            None => slowest.push((stage, took, done)),
        }
    }
    println!("{:12} {:>9} {:>14} {:>22}", "stage", "seconds", "longest gap", "slowest cancel, at");
    for (stage, longest, all) in gaps {
        let cancel = slowest.iter().find(|(other, ..)| *other == stage);
        let cancel = cancel.map_or("not hit".to_owned(), |(_, took, done)| {
            format!("{:.3} s, {:.0} %", took.as_secs_f64(), 100.0 * done)
        });
        let (all, longest) = (all.as_secs_f64(), longest.as_secs_f64());
        println!("{:12} {all:9.2} {longest:12.2} s {cancel:>22}", stage.name());
    }
    Ok(())
}
