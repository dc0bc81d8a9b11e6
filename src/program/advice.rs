//! Adds advice to errors and warnings. The library's text describes the problem; the advice names
//! the options of the program that help.

use bytesize::ByteSize;
use meniscus::error::{
    BinError, Error, FrameError, NoEstimate, PartsError, PictureError, ReadFault, Remedy,
    RereadError, SimulationError, TooFine, VulkanError, WhyOne, WriteFault, shown, significant,
};
use meniscus::{
    Comparison, Condition, EmptyReason, Mixture, NoVelocity, SpacingMistake, SpacingSource,
    SpacingWarning, TooSmall, Warning,
};

use super::options::ReconstructOptions;

/// The advice for an input that changes while it is read.
const CHANGED: &str = " (for a simulation, with --resume)";

/// The advice for scratch files that do not fit, or that cannot be written.
const NO_SCRATCH: &str = "; use another folder with --scratch, or a larger --memory";

/// Prints an error with advice.
pub fn say_error(error: &Error) {
    super::notes::say(&format!("meniscus: {}", error_message(error)));
}

/// Prints an error of a command that lacks the options `--backend` and `--scratch`. The advice does
/// not name these options.
pub fn say_error_without_machine(error: &Error) {
    let names_machine = match error {
        Error::Vulkan(_) => true,
        Error::Read(error) => matches!(error.fault, ReadFault::Scratch(_)),
        _ => false,
    };
    if names_machine {
        super::notes::say(&format!("meniscus: {error}"));
    } else {
        say_error(error);
    }
}

/// Prints all errors except the last one, and returns the last one for the caller to print.
pub fn all_or_last(mut errors: Vec<Error>) -> Result<(), Error> {
    let last = errors.pop();
    errors.iter().for_each(say_error_without_machine);
    last.map_or(Ok(()), Err)
}

/// The text of an error with advice.
pub fn error_message(error: &Error) -> String {
    in_options(error).unwrap_or_else(|| format!("{error}{}", advice(error)))
}

/// The text of an error that must name options, or `None` if the library's text suffices.
fn in_options(error: &Error) -> Option<String> {
    Some(match error {
        Error::SettingConflict(_) | Error::Unit(_) => {
            error.message_with(&|setting| format!("--{setting}"))
        }
        Error::LittleMemory { least, simplifying: None } => {
            format!("--memory must be at least {}", ByteSize(*least))
        }
        Error::LittleMemory { least, simplifying: Some(1) } => {
            format!("--simplify needs a --memory of at least {}", ByteSize(*least))
        }
        Error::LittleMemory { least, simplifying: Some(threads) } => format!(
            "--simplify with {threads} threads needs a --memory of at least {}; with fewer \
             --threads, it needs less",
            ByteSize(*least)
        ),
        Error::Simulation(SimulationError::Rate { .. } | SimulationError::Timeout(_)) => {
            format!("--{error}")
        }
        Error::Simulation(SimulationError::Steps(inputs)) => {
            format!(
                "{inputs}: --watch cannot watch for new frames inside one file; convert the file \
                 when the simulation has ended"
            )
        }
        Error::Simulation(SimulationError::Range { first, last }) => {
            format!("--start {first} is after --end {last}")
        }
        _ => return None,
    })
}

/// Whether a particle file could not be read because its extension is unknown.
fn has_unknown_particle_extension(fault: &ReadFault) -> bool {
    let ReadFault::UnknownExtension { known } = fault else { return false };
    known.split([' ', ',']).any(|known| known == ".bgeo")
}

fn advice(error: &Error) -> String {
    match error {
        Error::NoSpacing { why: NoEstimate::SinglePrecision { .. }, .. } => {
            " (--spacing, --cell-size), store the coordinates in double precision, or move the \
             particles to the origin"
        }
        Error::NoSpacing { why: NoEstimate::NotFinite, .. } => "",
        Error::NoSpacing { .. } => " (--spacing, --radius or --cell-size)",
        Error::Threads(_) => "; use fewer --threads",
        Error::Write(error) => match error.fault {
            WriteFault::Exists => "; --overwrite replaces it",
            WriteFault::ExistsInSimulation => {
                "; --resume keeps finished frames, --overwrite replaces them"
            }
            _ => "",
        },
        Error::Read(error) if has_unknown_particle_extension(&error.fault) => {
            "; if this is a particle file with another extension, use --format"
        }
        Error::Read(error) if matches!(error.fault, ReadFault::Changed) => CHANGED,
        Error::Read(error) if matches!(error.fault, ReadFault::Scratch(_)) => NO_SCRATCH,
        Error::Vulkan(VulkanError::SmallStack { .. }) => ", or use --backend cpu",
        Error::Vulkan(VulkanError::NoDevice) => "; install a Vulkan driver, or use --backend cpu",
        Error::Vulkan(VulkanError::NotFound { .. }) => {
            "; choose a device with --device, or use --backend cpu"
        }
        Error::Vulkan(_) => "; use --backend cpu",
        Error::Picture { fault: PictureError::Memory { .. }, .. } => " with --memory",
        Error::Simulation(SimulationError::NoFrameSelected(_)) => {
            " (--start, --end, --step, --frames)"
        }
        Error::Simulation(SimulationError::OtherInputs { .. }) => {
            ", or use --overwrite to replace the existing ones"
        }
        Error::Simulation(SimulationError::Several {
            why: WhyOne::Pattern | WhyOne::Names,
            ..
        }) => "; --together makes one surface from the particles of all simulations",
        Error::Simulation(SimulationError::State { .. }) => "; use --overwrite to start again",
        // If `differing` begins with this text, only the input has changed, and no setting has.
        Error::Simulation(SimulationError::Settings { differing, .. })
            if differing.starts_with("the input of frame") =>
        {
            "; use --resume or --overwrite to start again"
        }
        Error::Simulation(SimulationError::Settings { differing, .. }) if differing == "fps" => {
            "; use the old --fps, or change it with --resume and --overwrite"
        }
        Error::Simulation(SimulationError::Settings { .. }) => {
            "; undo the changes, or use --overwrite to make all frames again"
        }
        Error::Frame {
            fault: FrameError::TooFine(TooFine::Steps { remedy: Remedy::Origin(corner), .. }),
            ..
        } => {
            return format!(" (--origin {})", corner.map(|x| x.to_string()).join(","));
        }
        Error::Parts(PartsError::NoPlan(_)) => " (--plan)",
        Error::Parts(
            PartsError::Plan { .. } | PartsError::Settings { .. } | PartsError::Changed { .. },
        ) => " (--plan with --resume or --overwrite)",
        Error::Parts(
            PartsError::Missing { .. } | PartsError::Damaged { .. } | PartsError::OtherPlan(_),
        ) => " (--part)",
        Error::Frame { fault, .. } => advice_on_frame(fault),
        _ => "",
    }
    .to_owned()
}

fn advice_on_frame(fault: &FrameError) -> &'static str {
    match fault {
        FrameError::Unread(RereadError::Changed) => CHANGED,
        FrameError::Bin(BinError::NotFinite { .. }) => " (--skip-invalid)",
        FrameError::Bin(BinError::TooFar { .. }) => {
            " (--cell-size, --origin), or skip such particles (--skip-invalid)"
        }
        FrameError::Bin(BinError::OutsideBox { .. }) => " (--periodic, --skip-invalid)",
        FrameError::NoParticles(census) if census.outside > 0 => "; check --domain and --periodic",
        FrameError::OverBudget(_) => " or a larger --memory",
        FrameError::NoSpacing => " with --spacing",
        FrameError::TooFine(TooFine::Steps { .. }) => " (--cell-size)",
        FrameError::TooFine(TooFine::Finest { .. }) => {
            " (--cell 0.1 or more); check the spacing (--spacing)"
        }
        FrameError::TooFine(TooFine::Symmetry { .. }) => {
            " (--cell above 0.5), or another --indicator"
        }
        FrameError::NoSurface { .. } => {
            " (--iso, --cell), a smaller --sigma, or --indicator cloud, which keeps drops and \
             sheets; check the spacing (--spacing)"
        }
        FrameError::NothingLeft(TooSmall { drops: 0, .. }) => {
            "; use a smaller --smallest-component"
        }
        FrameError::NothingLeft(TooSmall { components: 0, .. }) => {
            "; use a smaller --smallest-drop"
        }
        FrameError::NothingLeft(_) => "; use a smaller --smallest-component or --smallest-drop",
        FrameError::NoDistanceSurface { .. } => " (--cell); check the spacing (--spacing)",
        FrameError::NoKernelSurface => {
            " (--cell) or, except with --method zhu-bridson, a lower --iso"
        }
        FrameError::WideAttributes { .. } => " (--attributes, --memory)",
        FrameError::NoRoom { .. } | FrameError::Scratch { .. } => NO_SCRATCH,
        _ => "",
    }
}

/// The text of a warning about a spacing, with advice.
pub fn spacing_message(warning: &SpacingWarning) -> String {
    match warning {
        SpacingWarning::Contradicted { found, source: SpacingSource::Packed, spray, .. } => {
            format!(
                "{warning}; {}pack the particles again with --spacing {}",
                otherwise(*spray),
                significant(*found, 3)
            )
        }
        SpacingWarning::Contradicted {
            given,
            found,
            mistake: Some(SpacingMistake::Radius),
            spray,
            ..
        } => {
            format!(
                "{warning}; {}use --radius {} or --spacing {}",
                otherwise(*spray),
                shown(*given),
                significant(*found, 3)
            )
        }
        SpacingWarning::Contradicted { found, spray, .. } => {
            format!("{warning}; {}use --spacing {}", otherwise(*spray), significant(*found, 3))
        }
        SpacingWarning::SinglePrecision { .. } => {
            format!(
                "{warning}; store the coordinates in double precision, or move the particles to \
                 the origin"
            )
        }
        SpacingWarning::Mixed(Mixture { attribute, fluid: (value, _), .. }) => {
            let values = vec![value.to_string()];
            let fluid =
                Condition { name: attribute.clone(), comparison: Comparison::Equal, values };
            format!("{warning}; use --where {} to select the fluid", shell_word(&fluid.to_string()))
        }
        SpacingWarning::TwoResolutions { .. } => format!(
            "{warning}; use --size if an attribute holds the particles' sizes, or --spacing to \
             choose a different spacing"
        ),
        SpacingWarning::MoreSizes { .. } => {
            format!("{warning}; convert frames that have several sizes separately")
        }
        SpacingWarning::SizesContradicted { spray, .. } => format!(
            "{warning}; {}choose another attribute with --size, or set --spacing, which ignores \
             the sizes",
            otherwise(*spray)
        ),
        SpacingWarning::Sizes { .. } => {
            format!("{warning}; use --size none to treat all particles as one size")
        }
        _ => format!("{warning}; use --spacing if you know it"),
    }
}

/// The beginning of advice that does not apply if the particles are spray. In that case, the
/// warning already says that the spacing, or the sizes, can be right.
fn otherwise(spray: bool) -> &'static str {
    if spray { "otherwise, " } else { "" }
}

/// Returns the text as one word for a shell, quoted if necessary.
fn shell_word(text: &str) -> String {
    let is_plain = |c: char| c.is_alphanumeric() || "_-.,=/:+".contains(c);
    if !text.is_empty() && text.chars().all(is_plain) {
        return text.to_owned();
    }
    format!("'{}'", text.replace('\'', r"'\''"))
}

/// The option to suggest if particles are outside the surface. `smoothed` is true for all
/// indicators except cloud.
fn on_lost_particles(smoothed: bool) -> &'static str {
    if smoothed { "--indicator cloud" } else { "--cell" }
}

/// The message, with advice, that none of the particles' attributes is recognised as a velocity.
pub fn no_velocity_message(found: &NoVelocity) -> String {
    format!("{found}; to transfer attributes to the mesh, use --attributes")
}

/// The text of a warning, with advice that depends on `options`.
pub fn warning_message(warning: &Warning, options: Option<&ReconstructOptions>) -> String {
    match warning {
        Warning::Spacing(warning) => spacing_message(warning),
        Warning::Coincident { found, .. } if found.alone => {
            format!("{warning}; use --domain to leave them out")
        }
        Warning::Crowded { .. } => format!("{warning} (--spacing)"),
        Warning::CoarseCells { .. } => format!("{warning} (--cell)"),
        Warning::OnCorners { origin, .. } => {
            let corner = origin.map(|x| x.to_string()).join(",");
            format!("{warning} (--origin {corner})")
        }
        Warning::Lost { smoothed, .. } => {
            let at_solids =
                options.is_some_and(|options| !options.settings.solid_files().is_empty());
            let unless = if at_solids { ", unless they are inside a --solid" } else { "" };
            format!("{warning} ({}){unless}", on_lost_particles(*smoothed))
        }
        Warning::BeforeWall(_) => format!("{warning} (--domain)"),
        Warning::ThinSolid { .. } => format!("{warning} (--cell, --solid-offset)"),
        Warning::Shortfall { clouds, calibration_frame, .. } => {
            let what = if *clouds { "plateau" } else { "isovalue" };
            let measured = calibration_frame.map_or(String::new(), |frame| {
                format!("; the {what} was measured on frame {frame}")
            });
            format!("{warning}{measured}{}", on_shortfall(options, *clouds))
        }
        Warning::Empty { why: EmptyReason::Field, clouds, calibration_frame } => {
            // The text of the warning ends with the isovalue, so the relative clause refers to the
            // isovalue.
            let measured = calibration_frame
                .map_or(String::new(), |frame| format!(", which was measured on frame {frame}"));
            format!("{warning}{measured}{}", on_shortfall(options, *clouds))
        }
        Warning::Empty { why: EmptyReason::TooSmall(all), .. } => {
            format!("the mesh is empty: {} removed all components", limits(*all))
        }
        _ => warning.to_string(),
    }
}

/// Advice for a surface that encloses too little volume.
fn on_shortfall(options: Option<&ReconstructOptions>, clouds: bool) -> String {
    let mut advice = String::new();
    if options.is_some_and(|options| options.settings.isovalue().is_some()) {
        advice += "; use a lower --iso, or --iso auto";
    } else if options.is_some_and(|options| options.settings.kernels().is_none()) && !clouds {
        advice += "; use --indicator cloud, which keeps drops and sheets";
    }
    advice + "; check the spacing (--spacing)"
}

/// The names of the options that removed all components from the mesh.
fn limits(too_small: TooSmall) -> &'static str {
    match (too_small.components, too_small.drops) {
        (_, 0) => "--smallest-component",
        (0, _) => "--smallest-drop",
        _ => "--smallest-component and --smallest-drop",
    }
}

#[cfg(test)]
mod tests {
    use std::io;
    use std::path::PathBuf;

    use meniscus::GapAtWall;
    use meniscus::error::{ReadError, WriteError};

    use super::*;

    #[test]
    fn shell_words_with_spaces_and_apostrophes_are_quoted() {
        for (text, word) in [
            ("Type=1", "Type=1"),
            ("a<1", "'a<1'"),
            ("john's water.ply", r"'john'\''s water.ply'"),
            ("", "''"),
        ] {
            assert_eq!(shell_word(text), word);
        }
    }

    fn path(text: &str) -> PathBuf {
        text.into()
    }

    /// One example of each error with advice, or with names of options in its text.
    fn errors() -> Vec<Error> {
        let frame = |fault| Error::Frame { path: Some(path("f_1.vtk")), fault };
        let spacing = |why| Error::NoSpacing { path: None, particles: 7, why, suggested: None };
        let memory = |simplifying| Error::LittleMemory { least: 16 << 20, simplifying };
        let write = |fault: WriteFault| WriteError::new("m.ply".as_ref(), fault).into();
        let read = |fault: ReadFault| ReadError::new("f_1.vtk", fault).into();
        let full_disk = || io::Error::from(io::ErrorKind::StorageFull);
        let state = || path("mesh/f.ply.meniscus/state.json");
        let settings = |differing: &str| {
            SimulationError::Settings { path: state(), differing: differing.to_owned() }.into()
        };
        let parts = || path("m.ply.meniscus-parts");
        let plan = || parts().join("plan.json");
        let remedy = Remedy::Origin([0.5; 3]);
        let steps = TooFine::Steps { cell_size: 0.1, plateau: 9.0, step_cells: 0.2, remedy };
        let nothing_left = TooSmall { components: 1, drops: 0 };
        vec![
            memory(None),
            memory(Some(1)),
            memory(Some(4)),
            SimulationError::Timeout(-1.0).into(),
            SimulationError::Steps("sim.h5part".into()).into(),
            SimulationError::Range { first: 5, last: 3 }.into(),
            SimulationError::NoFrameSelected("f_{}.vtk".into()).into(),
            SimulationError::Several {
                from: "sim".into(),
                families: "oil_{} (8 frames), water_{} (8 frames)".into(),
                why: WhyOne::Pattern,
            }
            .into(),
            SimulationError::State {
                path: state(),
                what: "expected value at line 1 column 1".into(),
            }
            .into(),
            SimulationError::OtherInputs {
                path: state(),
                recorded: "/data/run_1".into(),
                inputs: "/data/run_2".into(),
                frame: 1,
            }
            .into(),
            settings("cell"),
            settings("fps"),
            settings("cell, the input of frame 1"),
            settings("the input of frame 1"),
            spacing(NoEstimate::TooFew),
            spacing(NoEstimate::SinglePrecision { step: 0.03 }),
            write(WriteFault::Exists),
            write(WriteFault::ExistsInSimulation),
            ReadError::new("f.abc", ReadFault::UnknownExtension { known: ".bgeo, .csv" }).into(),
            read(ReadFault::Changed),
            read(ReadFault::Scratch(full_disk())),
            Error::Vulkan(VulkanError::NoDevice),
            Error::Vulkan(VulkanError::SmallStack { limit: 16 << 10, least: 256 << 10 }),
            Error::Picture {
                path: Some(path("m.ply")),
                fault: PictureError::Memory { needed: 1 << 30, allowed: 1 << 20 },
            },
            frame(FrameError::TooFine(steps)),
            frame(FrameError::TooFine(TooFine::Finest { cell_size: 0.001, spacing: 0.05 })),
            frame(FrameError::TooFine(TooFine::Symmetry { cell_size: 0.02, spacing: 0.05 })),
            frame(FrameError::Unread(RereadError::Changed)),
            frame(FrameError::Bin(BinError::NotFinite { index: 7, position: [f64::NAN; 3] })),
            frame(FrameError::Bin(BinError::OutsideBox {
                index: 7,
                position: [2.0, 0.0, 0.0],
                axis: 'x',
                farthest: 0.05,
            })),
            frame(FrameError::NoSpacing),
            frame(FrameError::NoDistanceSurface { at_solids: false }),
            frame(FrameError::NoDistanceSurface { at_solids: true }),
            frame(FrameError::NoKernelSurface),
            frame(FrameError::NothingLeft(nothing_left)),
            frame(FrameError::NoRoom { folder: path("/tmp"), needed: 1 << 30, free: 1 << 20 }),
            frame(FrameError::Scratch { folder: path("/tmp"), fault: full_disk() }),
            frame(FrameError::WideAttributes { components: 300, needed: 1 << 30, budget: 1 << 20 }),
            PartsError::NoPlan(plan()).into(),
            PartsError::Settings { path: plan(), differing: "smooth".into() }.into(),
            PartsError::Missing { folder: parts(), missing: vec![0, 2], of: 3 }.into(),
            PartsError::OtherPlan(parts().join("part_2")).into(),
            PartsError::Io { path: plan(), fault: full_disk() }.into(),
        ]
    }

    fn warnings() -> Vec<Warning> {
        let contradicted = |source, mistake, spray| {
            Warning::Spacing(SpacingWarning::Contradicted {
                given: 0.025,
                source,
                found: 0.05,
                mistake,
                spray,
            })
        };
        let spacing = |source, mistake| contradicted(source, mistake, false);
        let sizes = |found, spray| {
            Warning::Spacing(SpacingWarning::SizesContradicted {
                attribute: "h".into(),
                sizes: [0.1, 0.4],
                found,
                spray,
            })
        };
        let empty =
            |why, calibration_frame| Warning::Empty { why, clouds: false, calibration_frame };
        vec![
            spacing(SpacingSource::Given, Some(SpacingMistake::Radius)),
            spacing(SpacingSource::Given, None),
            spacing(SpacingSource::Packed, None),
            contradicted(SpacingSource::Given, Some(SpacingMistake::Radius), true),
            contradicted(SpacingSource::Given, None, true),
            contradicted(SpacingSource::Packed, None, true),
            Warning::Spacing(SpacingWarning::Random { used: 0.05 }),
            Warning::Spacing(SpacingWarning::SinglePrecision { step: 0.03, spacing: 0.05 }),
            Warning::Spacing(SpacingWarning::TwoResolutions { spacings: [0.05, 0.1], used: 0.05 }),
            Warning::Spacing(SpacingWarning::MoreSizes {
                attribute: "h".into(),
                sizes: [0.1, 0.4],
                used: 0.2,
            }),
            sizes(0.05, false),
            sizes(2.0, true),
            Warning::Crowded { times: 8.5, spacing: 0.1 },
            Warning::BeforeWall(GapAtWall { axis: 'y', wall: -0.05, end: 0.002 }),
            Warning::CoarseCells { cell_size: 0.3, spacing: 0.1 },
            Warning::OnCorners { mean: 0.02, origin: [0.5; 3] },
            Warning::Lost { lost: 12, of: 1000, smoothed: true },
            Warning::Lost { lost: 12, of: 1000, smoothed: false },
            Warning::ThinSolid { path: path("plate.obj"), thickness: 0.01, cell_size: 0.025 },
            empty(EmptyReason::Field, Some(1)),
            empty(EmptyReason::TooSmall(TooSmall { components: 1, drops: 2 }), None),
        ]
    }

    /// The committed list reveals every change of a message or its advice. `MENISCUS_UPDATE=1`
    /// rewrites the list.
    #[test]
    fn every_advice_matches_the_committed_list() {
        let warnings = warnings();
        let lines = errors().iter().map(error_message).collect::<Vec<_>>().into_iter();
        let lines = lines.chain(warnings.iter().map(|warning| warning_message(warning, None)));
        let listed: String = lines.map(|line| format!("{line}\n")).collect();
        let file = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/program/advice.txt");
        if std::env::var_os("MENISCUS_UPDATE").is_some() {
            std::fs::write(&file, &listed).unwrap();
        }
        assert_eq!(listed, std::fs::read_to_string(&file).unwrap());
    }
}
