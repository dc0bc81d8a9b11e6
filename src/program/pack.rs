//! `meniscus pack`: converts particles to a packed frame.

use std::path::PathBuf;

use bytesize::ByteSize;
use clap::Args;
use meniscus::files::{InputFormat, Replace};
use meniscus::{Error, Reconstruction, Settings};

use super::interrupt;
use super::notes::Verdict;
use super::one_frame::refuse_same_file;
use super::report::{report_census, report_opened, report_stages, warn_all};
use super::run::{RunOptions, bytes_of};

#[derive(Args)]
pub struct PackOptions {
    #[arg(value_name = "INPUT", help = "Particle file", long_help = format!("Particle file: {}.", InputFormat::KNOWN))]
    input: PathBuf,
    /// Packed frame to write (.mnf).
    #[arg(short, long)]
    output: PathBuf,
    #[command(flatten)]
    settings: Settings,
    #[command(flatten)]
    run: RunOptions,
}

/// Runs `meniscus pack`.
pub fn run(options: &PackOptions) -> Result<Verdict, Error> {
    let PackOptions { input, output, settings, run } = options;
    let notes = run.notes();
    let request = Reconstruction::new().with_settings(settings.clone());
    request.check_packing()?;
    request.check(input)?;
    // Packed frames contain no attributes, so `pack` reads none.
    let request = request.attributes([""; 0]).cancel(interrupt::handle());
    let request = run.machine(request, output, || bytes_of([input.as_path()]))?;
    request.check(input)?;
    refuse_same_file(input, output)?;
    let replace = if run.overwrite { Replace::Allow } else { Replace::Refuse };
    let packed = request.packed_output(output, replace)?;

    let opened = request.open(input)?;
    report_opened(std::slice::from_ref(input), &opened, &notes);
    let frame = opened.sample()?;
    warn_all(&frame.warnings(), None, &notes);
    let packed = frame.pack(packed)?;
    report_census(&packed.census, &notes);
    notes.say(format!(
        "{}: {} cells in {} bricks, {} in {:.2} s",
        output.display(),
        packed.cells,
        packed.bricks,
        ByteSize(packed.bytes),
        packed.timings.total(),
    ));
    report_stages(&packed.timings, &notes);
    Ok(Verdict::Good)
}
