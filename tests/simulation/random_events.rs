//! Tests conversions that random events disturb: parallel jobs are killed or interrupted, inputs
//! appear, grow and are rewritten, and outputs are damaged. A final run with `--resume` must give
//! exactly the files of a single run with the same state.
//!
//! `MENISCUS_SEQUENCES=500` tries 500 sequences, `MENISCUS_SEQUENCES_FROM=1000` starts with number
//! 1000, and `MENISCUS_SEQUENCE=77` repeats number 77.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use tempfile::TempDir;

use crate::common::files::{raw, tree};
use crate::common::scene::Random;
use crate::common::{fill, program};

/// Default number of sequences to try.
const SEQUENCES: u64 = 10;

/// A conversion with random events.
struct Sequence {
    folder: TempDir,
    random: Random,
    frames: u64,
    /// Number of inputs that were written. Each input is different.
    written: u64,
    /// Whether records were damaged. The program treats a mesh without a record as a foreign file.
    /// If the input of its frame now gives a different mesh, only `--overwrite` replaces the file.
    lost_records: bool,
    format: &'static str,
    history: String,
}

impl Sequence {
    fn new(seed: u64) -> Self {
        let mut random = Random::new(seed.wrapping_mul(0x9e37_79b9).wrapping_add(1));
        let format = ["ply", "vtp", "ply", "pvtp", "obj", "usdc"][(random.bits() % 6) as usize];
        let folder = tempfile::tempdir().unwrap();
        ["in", "out", "alone"]
            .iter()
            .for_each(|name| fs::create_dir(folder.path().join(name)).unwrap());
        let mut sequence = Self {
            folder,
            random,
            frames: 0,
            written: 0,
            lost_records: false,
            format,
            history: format!("{seed}, .{format}:"),
        };
        for _ in 0..2 + sequence.pick(4) {
            sequence.grow();
        }
        sequence
    }

    fn pick(&mut self, below: u64) -> u64 {
        self.random.bits() % below
    }

    fn note(&mut self, what: impl std::fmt::Display) {
        write!(self.history, " {what}").unwrap();
    }

    fn input(&self, frame: u64) -> PathBuf {
        self.folder.path().join(format!("in/f_{frame}.xyz"))
    }

    /// Writes a frame with a new ball, in two steps or at once.
    fn write(&mut self, frame: u64) {
        self.written += 1;
        let (seed, radius) = (self.written, 3.0 + 0.1 * (self.written % 10) as f64);
        let ball = fill(10.0, 1.0, 0.3, seed, |p| p.length() < radius);
        let bytes = raw(&ball);
        let path = self.input(frame);
        if self.pick(3) == 0 {
            fs::write(&path, &bytes[..bytes.len() / 24 * 12]).unwrap();
            std::thread::sleep(Duration::from_millis(self.pick(10)));
            fs::write(&path, &bytes).unwrap();
        } else {
            let whole = self.folder.path().join("being_written");
            fs::write(&whole, bytes).unwrap();
            fs::rename(whole, path).unwrap();
        }
    }

    fn grow(&mut self) {
        self.frames += 1;
        self.write(self.frames);
    }

    fn command(&self, out: &str, more: &[&str]) -> Command {
        let output = format!("{out}/m_{{}}.{}", self.format);
        let usual = ["reconstruct", "in/f_{}.xyz", "-o", &output, "-q"];
        let mut command = program::command(self.folder.path(), &usual);
        command
            .args(["--spacing", "1", "--cell", "1", "--threads", "1", "--backend", "cpu"])
            .args(more);
        command.stderr(Stdio::piped());
        command
    }

    /// Starts a job for all frames or for some frames.
    fn job(&mut self) -> Child {
        let some = self.pick(2) == 0;
        let first = 1 + self.pick(self.frames);
        let frames = format!("{first}..{}", first + self.pick(self.frames + 1 - first));
        let more = if some { &["--resume", "--frames", &frames][..] } else { &["--resume"] };
        self.note(if some { format!("job {frames}") } else { "job".into() });
        self.command("out", more).spawn().unwrap()
    }

    /// Waits for a job, or kills or interrupts it. The job must not panic.
    fn end(&mut self, mut job: Child) {
        let how = self.pick(4);
        if how < 3 {
            std::thread::sleep(Duration::from_millis(self.pick(60)));
        }
        match how {
            0 => job.kill().unwrap(),
            1 => drop(Command::new("kill").args(["-TERM", &job.id().to_string()]).status()),
            _ => {}
        }
        self.note(["killed", "interrupted", "ended", "ended"][how as usize]);
        let output = job.wait_with_output().unwrap();
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(!errors.contains("panicked"), "{}: {errors}", self.history);
        let code = output.status.code();
        assert!(
            matches!(code, None | Some(0 | 1 | 3 | 130)),
            "{}: {code:?}: {errors}",
            self.history
        );
    }

    /// Damages an output, or its record.
    fn damage(&mut self) {
        let out = self.folder.path().join("out");
        let files: Vec<PathBuf> = tree(&out)
            .into_keys()
            .map(|name| out.join(name))
            .filter(|path| !path.ends_with("state.json"))
            .collect();
        if files.is_empty() {
            return;
        }
        let path = &files[self.pick(files.len() as u64) as usize];
        let mut bytes = fs::read(path).unwrap();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        self.note(format!("damage {name}"));
        // Truncate or remove records, but do not change their content, which the program trusts.
        let is_record = name.ends_with(".jsonl");
        self.lost_records |= is_record;
        match self.pick(if is_record { 2 } else { 3 }) {
            0 => return fs::remove_file(path).unwrap(),
            1 => bytes.truncate(bytes.len() / 2),
            _ => {
                if let Some(byte) = bytes.get_mut(self.random.bits() as usize % 100) {
                    *byte ^= 1;
                }
            }
        }
        fs::write(path, bytes).unwrap();
    }

    fn event(&mut self) {
        match self.pick(8) {
            0 | 1 => {
                let job = self.job();
                self.end(job);
            }
            2 | 3 => {
                let jobs = [self.job(), self.job()];
                jobs.into_iter().for_each(|job| self.end(job));
            }
            4 => {
                let job = self.job();
                let frame = 1 + self.pick(self.frames);
                self.note(format!("write {frame}"));
                self.write(frame);
                self.end(job);
            }
            5 => {
                let frame = 1 + self.pick(self.frames);
                self.note(format!("write {frame}"));
                self.write(frame);
            }
            6 => {
                self.note("grow");
                self.grow();
            }
            _ => self.damage(),
        }
    }

    /// Makes all missing frames. If records were lost, replacing meshes may need `--overwrite`.
    fn finish(&self, out: &str) {
        let run = |options: &[&str]| {
            let output = self.command(out, options).output().unwrap();
            (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
        };
        let (mut code, mut errors) = run(&["--resume"]);
        if self.lost_records && errors.contains("--overwrite") {
            (code, errors) = run(&["--overwrite"]);
        }
        assert_eq!(code, Some(0), "{} {out}: {errors}", self.history);
    }

    /// Runs the events and compares the result with that of a single run.
    fn run(mut self) {
        for _ in 0..3 + self.pick(6) {
            self.event();
        }
        self.finish("out");
        // Give the single run a copy of the state, so that both conversions use the same
        // calibration. Without the copy, the single run could choose another calibration frame,
        // because more frames exist now than when the state was made.
        let state = format!("m.{}.meniscus/state.json", self.format);
        let [from, to] = ["out", "alone"].map(|name| self.folder.path().join(name).join(&state));
        fs::create_dir_all(to.parent().unwrap()).unwrap();
        fs::copy(from, to).unwrap();
        self.finish("alone");
        let [out, alone] = ["out", "alone"].map(|name| tree(&self.folder.path().join(name)));
        let names = |files: &BTreeMap<String, Vec<u8>>| files.keys().cloned().collect::<Vec<_>>();
        assert_eq!(names(&out), names(&alone), "{}", self.history);
        let differing: Vec<String> = alone
            .iter()
            .filter(|(name, bytes)| out[*name] != **bytes)
            .map(|(name, bytes)| {
                let [found, expected] = [&out[name], bytes]
                    .map(|bytes| String::from_utf8_lossy(&bytes[..bytes.len().min(3000)]));
                format!("{name}: {found}\ninstead of {expected}")
            })
            .collect();
        assert!(differing.is_empty(), "{}: {}", self.history, differing.join("\n"));
        let extension = format!(".{}", self.format);
        let meshes = out.keys().filter(|name| name.starts_with("m_") && name.ends_with(&extension));
        let frames = meshes.filter(|name| !name.contains('/')).count();
        assert_eq!(frames as u64, self.frames, "{}", self.history);
    }
}

#[test]
fn resuming_after_random_events_gives_the_files_of_one_run() {
    let number =
        |name: &str| std::env::var(name).ok().map(|text| text.parse::<u64>().expect("a number"));
    if let Some(seed) = number("MENISCUS_SEQUENCE") {
        return Sequence::new(seed).run();
    }
    let first = number("MENISCUS_SEQUENCES_FROM").unwrap_or(0);
    let (begun, next) = (Instant::now(), AtomicU64::new(first));
    let all = number("MENISCUS_SEQUENCES").unwrap_or(SEQUENCES);
    let worker = || {
        loop {
            let seed = next.fetch_add(1, Ordering::Relaxed);
            if seed >= first + all {
                return;
            }
            Sequence::new(seed).run();
        }
    };
    std::thread::scope(|scope| (0..2).for_each(|_| drop(scope.spawn(worker))));
    println!("{all} sequences; {:.0} s", begun.elapsed().as_secs_f64());
}
