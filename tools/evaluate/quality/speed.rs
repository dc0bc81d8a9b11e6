//! Compares the speed of methods: the seconds that each program takes from file to file. The
//! programs run one after the other.

use std::num::NonZero;

use super::lines::Board;
use super::programs::{Method, Takes};
use crate::scene::splash;
use crate::tables::Table;
use crate::{Options, Outcome};

const CELLS: [f64; 2] = [0.5, 0.25];
/// Maximum number of threads of a program.
const THREADS: usize = 2;
/// A program runs a second time only if its first run took less than this many seconds.
const LONG: f64 = 5.0;

pub fn run(options: &Options, board: &Board) -> Outcome<()> {
    let count = options.choose(1_500_000, 100_000);
    let threads = std::thread::available_parallelism().map_or(1, NonZero::get).min(THREADS);
    let particles: Vec<[f64; 3]> = splash(count, 1).into_iter().map(|p| p.map(f64::from)).collect();
    let input = board.input(&particles)?;
    let timed = |method: &&Method| method.documented && method.program.takes == Takes::Many;
    let methods: Vec<&Method> = board.methods.iter().filter(timed).collect();
    let head: Vec<&str> =
        [""].into_iter().chain(methods.iter().map(|method| &*method.name)).collect();
    let mut table = Table::new(&head);
    for &cell in options.choose(&CELLS[..], &CELLS[..1]) {
        let seconds = methods.iter().map(|method| {
            let output = board.file("ply");
            let run = || method.run([&input, &output], Some(cell), threads);
            let first = run()?;
            let second = if first.is_some_and(|seconds| seconds < LONG) { run()? } else { None };
            std::fs::remove_file(&output).ok();
            Ok(first.into_iter().chain(second).reduce(f64::min))
        });
        let seconds: Vec<Option<f64>> = seconds.collect::<Outcome<_>>()?;
        let first = seconds[0].unwrap_or(f64::NAN);
        let text = |seconds: &Option<f64>| {
            seconds
                .map_or("none".into(), |seconds| format!("{seconds:.2} ({:.1})", seconds / first))
        };
        table.row([format!("cells {cell}")].into_iter().chain(seconds.iter().map(text)));
    }
    table.show(&format!(
        "seconds from file to file for {} particles in random order, with {threads} threads; the \
         faster of two runs if the first takes less than {LONG} s; in brackets, relative to the \
         first program",
        particles.len()
    ));
    Ok(())
}
