//! Errors and warnings with the options that help: the library says what is wrong, and knows of no
//! option.

use bytesize::ByteSize;
use meniscus::error::{
    BinError, Error, FrameError, PartsError, ReadFault, Remedy, SimulationError, TooFine, Unread,
    Untold, WriteFault, shown, significant,
};
use meniscus::{
    Comparison, Condition, Doubt, Emptiness, Mistake, Mixture, SpacingSource, TooSmall, Warning,
};

use super::options::Options;

/// Says an error, and what to do about it.
pub fn say_error(error: &Error) {
    super::notes::say(&format!("meniscus: {}", told(error)));
}

/// An error in words, and what to do about it.
pub fn told(error: &Error) -> String {
    in_options(error).unwrap_or_else(|| format!("{error}{}", advice(error)))
}

/// An error about options, in their names.
fn in_options(error: &Error) -> Option<String> {
    Some(match error {
        Error::Unfit(_) | Error::Unit(_) => error.told(&|setting| format!("--{setting}")),
        Error::LittleMemory { least, simplifying: None } => {
            format!("--memory must be at least {}", ByteSize(*least))
        }
        Error::LittleMemory { least, simplifying: Some(1) } => {
            format!("--simplify needs --memory of {}", ByteSize(*least))
        }
        Error::LittleMemory { least, simplifying: Some(threads) } => format!(
            "--simplify with {threads} threads needs --memory of {}; fewer --threads need less",
            ByteSize(*least)
        ),
        Error::Simulation(SimulationError::Rate { .. } | SimulationError::Wait(_)) => {
            format!("--{error}")
        }
        Error::Simulation(SimulationError::Steps(inputs)) => {
            format!("{inputs}: --watch cannot follow the steps inside one file")
        }
        Error::Simulation(SimulationError::Range { first, last }) => {
            format!("there are no frames from --start {first} to --end {last}")
        }
        Error::Simulation(SimulationError::NoneWanted(inputs)) => {
            format!("{inputs}: no frame matches --frames")
        }
        _ => return None,
    })
}

/// Whether a file could hold particles, if only its format were known.
fn is_of_unknown_particles(fault: &ReadFault) -> bool {
    matches!(fault, ReadFault::UnknownExtension { known } if known.split(", ").any(|known| known == ".bgeo"))
}

fn advice(error: &Error) -> String {
    match error {
        Error::NoSpacing { why: Untold::SinglePrecision { .. }, .. } => {
            "; store them in double precision, or nearer to the origin, or give --spacing"
        }
        Error::NoSpacing { .. } => "; give --spacing, --radius or --cell-size",
        Error::Write(error) => match error.fault {
            WriteFault::Exists => "; --overwrite replaces it",
            WriteFault::ExistsInSimulation => {
                "; --resume goes on with the frames, --overwrite replaces them"
            }
            _ => "",
        },
        Error::Read(error) if is_of_unknown_particles(&error.fault) => {
            "; --format names the format of particles"
        }
        Error::Read(error) if matches!(error.fault, ReadFault::Changed) => {
            "; --resume makes it again"
        }
        Error::Simulation(SimulationError::State { .. }) => "; --overwrite begins anew",
        Error::Simulation(SimulationError::Settings { .. }) => {
            "; --overwrite makes all frames anew"
        }
        Error::Frame {
            fault: FrameError::TooFine(TooFine::Steps { remedy: Remedy::Origin(corner), .. }),
            ..
        } => {
            return format!(": --origin {}", corner.map(|x| x.to_string()).join(","));
        }
        Error::Parts(PartsError::NoPlan(_)) => "; --plan makes it",
        Error::Parts(
            PartsError::Plan { .. } | PartsError::Settings { .. } | PartsError::Changed { .. },
        ) => "; --plan with --resume or --overwrite makes another",
        Error::Parts(PartsError::Missing { .. }) => "; --part makes them",
        Error::Parts(PartsError::Damaged { .. } | PartsError::Foreign(_)) => {
            "; --part makes it again"
        }
        Error::Frame { fault, .. } => advice_on_frame(fault),
        _ => "",
    }
    .to_owned()
}

fn advice_on_frame(fault: &FrameError) -> &'static str {
    match fault {
        FrameError::Unread(Unread::Changed) => "; convert it once it is written",
        FrameError::Bin(BinError::NotFinite { .. }) => "; --skip-invalid leaves out such particles",
        FrameError::Bin(BinError::TooFar { .. }) => {
            "; use a larger cell size, move --origin, or leave out such particles with --skip-invalid"
        }
        FrameError::OverBudget(_) => "; or allow more with --memory",
        FrameError::TooFine(TooFine::Finest { .. }) => {
            " (--cell 0.1 or more); is their --spacing right?"
        }
        FrameError::TooFine(TooFine::Symmetry { .. }) => {
            " (--cell of more than 0.5), or another --indicator"
        }
        FrameError::NoSurface { .. } => {
            "; --indicator cloud keeps drops and sheets that smoothing loses; else use smaller cells, a lower --iso or a smaller \
             --sigma; is the --spacing right?"
        }
        FrameError::NothingLeft(_) => {
            "; a smaller --smallest-component or --smallest-drop leaves more"
        }
        FrameError::NoDistanceSurface => "; use smaller cells; is the --spacing right?",
        FrameError::NoKernelSurface => "; use smaller cells, or a lower --iso",
        FrameError::WideAttributes { .. } => {
            "; name those that are needed with --attributes, or allow more with --memory"
        }
        FrameError::NoRoom { .. } => {
            "; name another folder with --scratch, or allow more with --memory"
        }
        _ => "",
    }
}

/// A doubt about a spacing in words, and what to do about it.
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
            format!("{doubt}; store them in double precision, or nearer to the origin")
        }
        Doubt::Mixed(Mixture { attribute, fluid: (value, _), .. }) => {
            let values = vec![value.to_string()];
            let fluid =
                Condition { name: attribute.clone(), comparison: Comparison::Equal, values };
            format!("{doubt}; --where {} selects the fluid", shell_word(&fluid.to_string()))
        }
        Doubt::TwoResolutions { .. } => format!("{doubt}; --spacing says another"),
        _ => format!("{doubt}; give --spacing if you know it"),
    }
}

/// A word as a shell takes it, in quotes where it needs them.
fn shell_word(text: &str) -> String {
    let is_plain = |c: char| c.is_alphanumeric() || "_-.,=/:+".contains(c);
    if !text.is_empty() && text.chars().all(is_plain) {
        return text.to_owned();
    }
    format!("'{}'", text.replace('\'', r"'\''"))
}

/// The advice on particles that are in no surface.
fn on_lost(smoothed: bool) -> &'static str {
    if smoothed { "--indicator cloud keeps drops" } else { "smaller cells keep more" }
}

/// A warning in words, and what to do about it, by what else was asked for.
pub fn warned(warning: &Warning, options: Option<&Options>) -> String {
    match warning {
        Warning::Spacing(doubt) => doubted(doubt),
        Warning::Coincident { found, .. } if found.alone => {
            format!("{warning}; --domain can leave them out")
        }
        Warning::Crowded { .. } => format!("{warning}: is their --spacing right?"),
        Warning::OnCorners { origin, .. } => {
            let corner = origin.map(|x| x.to_string()).join(",");
            format!("{warning}; --origin {corner} moves the grid off them")
        }
        Warning::Lost { smoothed, .. } => format!("{warning}; {}", on_lost(*smoothed)),
        Warning::ThinSolid { .. } => {
            "; use smaller cells, a thicker mesh or a greater --solid-offset".into()
        }
        Warning::Shortfall { clouds, measured_on, .. }
        | Warning::Empty { why: Emptiness::Field, clouds, measured_on } => {
            format!("{warning}{}", on_shortfall(options, *clouds, *measured_on))
        }
        Warning::Empty { why: Emptiness::TooSmall(all), .. } => {
            format!("all components are below {}: an empty mesh", limits(*all))
        }
        _ => warning.to_string(),
    }
}

/// The advice on a surface that holds less than its particles.
fn on_shortfall(options: Option<&Options>, clouds: bool, measured_on: Option<i64>) -> String {
    let mut advice = String::new();
    if let Some(frame) = measured_on {
        let what = if clouds { "its plateau" } else { "its isovalue" };
        advice += &format!("; {what} was measured on frame {frame}");
    }
    if options.is_some_and(|options| options.settings.isovalue().is_some()) {
        advice += "; a lower --iso, or --iso auto, shows more";
    } else if options.is_some_and(|options| options.settings.kernels().is_none()) && !clouds {
        advice += "; --indicator cloud keeps drops and sheets that smoothing loses";
    }
    advice + "; is their --spacing right?"
}

/// The options that left out all components of a surface.
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
