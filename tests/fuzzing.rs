//! Runs every target of `tests/fuzz` on stable Rust for a few seconds, always with the same
//! mutations of its seeds. libFuzzer runs the targets for hours (`tools/fuzz`).
//!
//! `MENISCUS_FUZZ_RUNS=100` multiplies the number of runs by 100, and `MENISCUS_FUZZ` selects the
//! targets whose names contain its value.
#![cfg(feature = "cli")]
#![allow(
    dead_code,
    clippy::unwrap_used,
    reason = "this program uses only some items of the shared modules"
)]

#[path = "fuzz/mutate.rs"]
mod mutate;
#[path = "../tools/bench/scene.rs"]
mod scene;
#[path = "fuzz/targets/mod.rs"]
mod targets;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Mutex;
use std::time::{Duration, Instant};

use targets::Target;

/// A seed is small if it has fewer bytes than this. In fast targets, the test damages every byte of
/// each small seed, one byte at a time.
const SMALL_SEED_BYTES: usize = 2000;
/// A target is fast if it has at least this number of runs.
const FAST_TARGET_RUNS: u32 = 2000;

/// Runs a target with its seeds and with mutations of them. Returns the number of runs and the
/// time.
fn fuzz(target: &Target, times: u32) -> (u32, Duration) {
    let begun = Instant::now();
    let seeds = (target.seeds)();
    assert!(!seeds.is_empty(), "{} has no seeds", target.name);
    let mut runs = 0;
    let mut run = |what: &dyn std::fmt::Display, data: &[u8]| {
        runs += 1;
        if catch_unwind(AssertUnwindSafe(|| (target.run)(data))).is_err() {
            panic!("{}: {what} fails: {}", target.name, data.escape_ascii());
        }
    };
    for (number, seed) in seeds.iter().enumerate() {
        run(&format_args!("seed {number}"), seed);
    }
    // In fast targets, damage every byte of the small seeds.
    for (number, seed) in seeds
        .iter()
        .enumerate()
        .filter(|(_, seed)| target.runs >= FAST_TARGET_RUNS && seed.len() < SMALL_SEED_BYTES)
    {
        for (at, mask) in
            (0..seed.len()).flat_map(|at| [0x01, 0x10, 0x80, 0xff].map(|mask| (at, mask)))
        {
            let mut data = seed.clone();
            data[at] ^= mask;
            run(&format_args!("seed {number} with byte {at} XORed with {mask:#x}"), &data);
        }
    }
    for number in 0..u64::from(target.runs) * u64::from(times) {
        let data = mutate::mutated(&seeds, target.words, number);
        run(&format_args!("mutation {number} of the seeds"), &data);
    }
    (runs, begun.elapsed())
}

#[test]
fn no_mutation_makes_a_target_panic() {
    let variable = |name: &str| std::env::var(name).ok();
    let times =
        variable("MENISCUS_FUZZ_RUNS").map_or(1, |times| times.parse().expect("a number of times"));
    let name = variable("MENISCUS_FUZZ").unwrap_or_default();
    let mut chosen: Vec<Target> =
        targets::all().into_iter().filter(|t| t.name.contains(&name)).collect();
    assert!(!chosen.is_empty(), "no target is called {name}");
    chosen.reverse();
    let remaining = Mutex::new(chosen);
    let worker = || {
        // Give each worker its own pool with one thread. Otherwise, targets of different workers
        // would share the global pool and wait for each other.
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let next = || remaining.lock().unwrap().pop();
        while let Some(target) = next() {
            let (runs, took) = pool.install(|| fuzz(&target, times));
            println!("{:12} {runs:9} runs {:8.2} s", target.name, took.as_secs_f64());
        }
    };
    std::thread::scope(|scope| {
        let threads = std::thread::available_parallelism().map_or(1, usize::from);
        let workers: Vec<_> = (0..threads).map(|_| scope.spawn(worker)).collect();
        let failed = workers.into_iter().filter_map(|worker| worker.join().err()).count();
        assert_eq!(failed, 0, "some targets failed; see the messages above");
    });
}
