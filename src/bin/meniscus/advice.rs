//! Advice for errors and warnings: the options that help. The library says what is wrong, but does
//! not know the options.

use bytesize::ByteSize;
use meniscus::error::{
    BinError, Error, FrameError, PartsError, ReadFault, Remedy, SimulationError, TooFine, Unread,
    Untold, WriteFault, shown, significant,
};
use meniscus::{
    Comparison, Condition, Doubt, Emptiness, Mistake, Mixture, SpacingSource, TooSmall, Warning,
};

use crate::options::Options;

/// Prints an error with advice.
pub fn say_error(error: &Error) {
    crate::notes::say(&format!("meniscus: {}", told(error)));
}

/// The text of an error with advice.
pub fn told(error: &Error) -> String {
    in_options(error).unwrap_or_else(|| format!("{error}{}", advice(error)))
}

/// The text of an error that names options.
fn in_options(error: &Error) -> Option<String> {
    Some(match error {
        Error::Unfit(_) | Error::Unit(_) => error.told(&|setting| format!("--{setting}")),
        Error::LittleMemory { least, simplifying: None } => {
            format!("--memory must be at least {}", ByteSize(*least))
        }
        Error::LittleMemory { least, simplifying: Some(1) } => {
            format!("--simplify needs a --memory of at least {}", ByteSize(*least))
        }
        Error::LittleMemory { least, simplifying: Some(threads) } => format!(
            "--simplify with {threads} threads needs a --memory of at least {}; fewer --threads need less",
            ByteSize(*least)
        ),
        Error::Simulation(SimulationError::Rate { .. } | SimulationError::Wait(_)) => {
            format!("--{error}")
        }
        Error::Simulation(SimulationError::Steps(inputs)) => {
            format!("{inputs}: --watch cannot follow the steps inside one file")
        }
        Error::Simulation(SimulationError::Range { first, last }) => {
            format!("--start {first} is after --end {last}")
        }
        Error::Simulation(SimulationError::NoneWanted(inputs)) => {
            format!("{inputs}: no frame matches --frames")
        }
        _ => return None,
    })
}

/// Whether a file of unknown extension is read as particles.
fn is_of_unknown_particles(fault: &ReadFault) -> bool {
    matches!(fault, ReadFault::UnknownExtension { known } if known.split(", ").any(|known| known == ".bgeo"))
}

fn advice(error: &Error) -> String {
    match error {
        Error::NoSpacing { why: Untold::SinglePrecision { .. }, .. } => {
            "; store the coordinates in double precision or move them to the origin, or use --spacing"
        }
        Error::NoSpacing { .. } => "; use --spacing, --radius or --cell-size",
        Error::Write(error) => match error.fault {
            WriteFault::Exists => "; --overwrite replaces it",
            WriteFault::ExistsInSimulation => {
                "; --resume keeps finished frames, --overwrite replaces them"
            }
            _ => "",
        },
        Error::Read(error) if is_of_unknown_particles(&error.fault) => {
            "; use --format for particle files with another extension"
        }
        Error::Read(error) if matches!(error.fault, ReadFault::Changed) => {
            "; use --resume to make this frame again"
        }
        Error::Simulation(SimulationError::State { .. }) => "; use --overwrite to start again",
        Error::Simulation(SimulationError::Settings { .. }) => {
            "; use the old settings, or --overwrite to make all frames again"
        }
        Error::Frame {
            fault: FrameError::TooFine(TooFine::Steps { remedy: Remedy::Origin(corner), .. }),
            ..
        } => {
            return format!(": --origin {}", corner.map(|x| x.to_string()).join(","));
        }
        Error::Parts(PartsError::NoPlan(_)) => "; run with --plan first",
        Error::Parts(
            PartsError::Plan { .. } | PartsError::Settings { .. } | PartsError::Changed { .. },
        ) => "; use --plan with --resume or --overwrite to replace the plan",
        Error::Parts(PartsError::Missing { .. }) => "; make them with --part",
        Error::Parts(PartsError::Damaged { .. } | PartsError::Foreign(_)) => {
            "; make it again with --part"
        }
        Error::Frame { fault, .. } => advice_on_frame(fault),
        _ => "",
    }
    .to_owned()
}

fn advice_on_frame(fault: &FrameError) -> &'static str {
    match fault {
        FrameError::Unread(Unread::Changed) => "; convert it when it is complete",
        FrameError::Bin(BinError::NotFinite { .. }) => {
            "; use --skip-invalid to leave out such particles"
        }
        FrameError::Bin(BinError::TooFar { .. }) => {
            "; use a larger cell size, move --origin, or leave out such particles with --skip-invalid"
        }
        FrameError::OverBudget(_) => " or a larger --memory",
        FrameError::TooFine(TooFine::Finest { .. }) => {
            " (--cell 0.1 or more); is the --spacing correct?"
        }
        FrameError::TooFine(TooFine::Symmetry { .. }) => {
            " (--cell of more than 0.5), or another --indicator"
        }
        FrameError::NoSurface { .. } => {
            "; use --indicator cloud, which keeps drops and sheets, or smaller cells, a lower --iso or a smaller \
             --sigma; is the --spacing correct?"
        }
        FrameError::NothingLeft(_) => "; use a smaller --smallest-component or --smallest-drop",
        FrameError::NoDistanceSurface => "; use smaller cells; is the --spacing correct?",
        FrameError::NoKernelSurface => "; use smaller cells, or a lower --iso",
        FrameError::WideAttributes { .. } => {
            "; select fewer with --attributes, or use a larger --memory"
        }
        FrameError::NoRoom { .. } => "; use another folder with --scratch, or a larger --memory",
        _ => "",
    }
}

/// The text of a doubt about a spacing, with advice.
pub fn doubted(doubt: &Doubt) -> String {
    match doubt {
        Doubt::Contradicted { found, source: SpacingSource::Packed, .. } => {
            format!("{doubt}; pack the particles again with --spacing {}", significant(*found, 3))
        }
        Doubt::Contradicted { said, found, mistake: Some(Mistake::Radius), .. } => {
            format!(
                "{doubt}; use --radius {} or --spacing {}",
                shown(*said),
                significant(*found, 3)
            )
        }
        Doubt::Contradicted { found, .. } => {
            format!("{doubt}; use --spacing {}", significant(*found, 3))
        }
        Doubt::SinglePrecision { .. } => {
            format!("{doubt}; store them in double precision, or move them to the origin")
        }
        Doubt::Mixed(Mixture { attribute, fluid: (value, _), .. }) => {
            let values = vec![value.to_string()];
            let fluid =
                Condition { name: attribute.clone(), comparison: Comparison::Equal, values };
            format!("{doubt}; use --where {} to select the fluid", shell_word(&fluid.to_string()))
        }
        Doubt::TwoResolutions { .. } => format!("{doubt}; use --spacing to choose another"),
        _ => format!("{doubt}; use --spacing if you know it"),
    }
}

/// A word for a shell, quoted if necessary.
fn shell_word(text: &str) -> String {
    let is_plain = |c: char| c.is_alphanumeric() || "_-.,=/:+".contains(c);
    if !text.is_empty() && text.chars().all(is_plain) {
        return text.to_owned();
    }
    format!("'{}'", text.replace('\'', r"'\''"))
}

/// Advice for particles that are missing from the surface.
fn on_lost(smoothed: bool) -> &'static str {
    if smoothed { "use --indicator cloud, which keeps drops" } else { "use smaller cells" }
}

/// The text of a warning, with advice that suits the other options.
pub fn warned(warning: &Warning, options: Option<&Options>) -> String {
    match warning {
        Warning::Spacing(doubt) => doubted(doubt),
        Warning::Coincident { found, .. } if found.alone => {
            format!("{warning}; use --domain to leave them out")
        }
        Warning::Crowded { .. } => format!("{warning}: is the --spacing correct?"),
        Warning::OnCorners { origin, .. } => {
            let corner = origin.map(|x| x.to_string()).join(",");
            format!("{warning}; use --origin {corner} to move the grid")
        }
        Warning::Lost { smoothed, .. } => format!("{warning}; {}", on_lost(*smoothed)),
        Warning::Shortfall { clouds, measured_on, .. }
        | Warning::Empty { why: Emptiness::Field, clouds, measured_on } => {
            format!("{warning}{}", on_shortfall(options, *clouds, *measured_on))
        }
        Warning::Empty { why: Emptiness::TooSmall(all), .. } => {
            format!("the mesh is empty: all components are below {}", limits(*all))
        }
        _ => warning.to_string(),
    }
}

/// Advice for a surface that encloses too little.
fn on_shortfall(options: Option<&Options>, clouds: bool, measured_on: Option<i64>) -> String {
    let mut advice = String::new();
    if let Some(frame) = measured_on {
        let what = if clouds { "its plateau" } else { "its isovalue" };
        advice += &format!("; {what} was measured on frame {frame}");
    }
    if options.is_some_and(|options| options.settings.isovalue().is_some()) {
        advice += "; use a lower --iso, or --iso auto";
    } else if options.is_some_and(|options| options.settings.kernels().is_none()) && !clouds {
        advice += "; use --indicator cloud, which keeps drops and sheets";
    }
    advice + "; is the --spacing correct?"
}

/// The options that left out all components.
fn limits(too_small: TooSmall) -> &'static str {
    match (too_small.components, too_small.drops) {
        (_, 0) => "--smallest-component",
        (0, _) => "--smallest-drop",
        _ => "--smallest-component and --smallest-drop",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_with_blanks_and_apostrophes_are_one_word_to_a_shell() {
        for (text, word) in [
            ("Type=1", "Type=1"),
            ("a<1", "'a<1'"),
            ("john's water.ply", r"'john'\''s water.ply'"),
            ("", "''"),
        ] {
            assert_eq!(shell_word(text), word);
        }
    }
}
