// The program's modules, all but `main`, in whatever crate includes this: what it makes of its
// arguments is fuzzed as all else is.
#[path = "../../src/bin/meniscus/advice.rs"]
mod advice;
#[path = "../../src/bin/meniscus/arguments.rs"]
mod arguments;
#[path = "../../src/bin/meniscus/devices.rs"]
mod devices;
#[path = "../../src/bin/meniscus/foreign.rs"]
mod foreign;
#[path = "../../src/bin/meniscus/info.rs"]
mod info;
#[path = "../../src/bin/meniscus/inspect.rs"]
mod inspect;
#[path = "../../src/bin/meniscus/interrupt.rs"]
mod interrupt;
#[path = "../../src/bin/meniscus/notes.rs"]
mod notes;
#[path = "../../src/bin/meniscus/one_frame.rs"]
mod one_frame;
#[path = "../../src/bin/meniscus/options.rs"]
mod options;
#[path = "../../src/bin/meniscus/pack.rs"]
mod pack;
#[path = "../../src/bin/meniscus/parts.rs"]
mod parts;
#[path = "../../src/bin/meniscus/progress.rs"]
mod progress;
#[path = "../../src/bin/meniscus/reconstruct.rs"]
mod reconstruct;
#[path = "../../src/bin/meniscus/render.rs"]
mod render;
#[path = "../../src/bin/meniscus/report.rs"]
mod report;
#[path = "../../src/bin/meniscus/run.rs"]
mod run;
#[path = "../../src/bin/meniscus/shells.rs"]
mod shells;
#[path = "../../src/bin/meniscus/simulation.rs"]
mod simulation;
#[path = "../../src/bin/meniscus/stats.rs"]
mod stats;
