//! Errors with the options that help: the library says what is wrong, and knows of no option.

use meniscus::brick::BinError;
use meniscus::error::{Error, SequenceError};
use meniscus::field::calibration::TooFine;
use meniscus::frame::FrameError;
use meniscus::grid::units::UnitError;
use meniscus::io::WriteFault;

/// An error in words, and what to do about it.
pub fn told(error: &Error) -> String {
    format!("{}{error}{}", option(error), advice(error))
}

/// The option that an error is about, where it begins with what that is for.
fn option(error: &Error) -> &'static str {
    match error {
        Error::Unit(UnitError::Smooth(_)) => "--",
        Error::Unit(UnitError::Tolerance(_)) => "--simplify: ",
        _ => "",
    }
}

fn advice(error: &Error) -> &'static str {
    match error {
        Error::NoSpacing { .. } => "; give --spacing, --radius or --cell-size",
        Error::Write(error) => match error.fault {
            WriteFault::Exists => "; --overwrite replaces it",
            WriteFault::ExistsInSequence => "; --resume goes on with the frames, --overwrite replaces them",
            _ => "",
        },
        Error::Sequence(SequenceError::State { .. }) => "; --overwrite begins anew",
        Error::Sequence(SequenceError::Settings { .. }) => {
            "; --resume makes them again, --overwrite begins anew"
        }
        Error::Frame { fault, .. } => advice_on_frame(fault),
        _ => "",
    }
}

fn advice_on_frame(fault: &FrameError) -> &'static str {
    match fault {
        FrameError::Bin(BinError::NotFinite { .. }) => "; --skip-invalid drops such particles",
        FrameError::Bin(BinError::TooFar { .. }) => {
            "; use a larger cell size, move --origin, or drop such particles with --skip-invalid"
        }
        FrameError::OverBudget(_) => "; or allow more with --memory",
        FrameError::TooFine(TooFine::Finest { .. }) => "; is their --spacing right?",
        FrameError::TooFine(TooFine::Symmetry { .. }) => ", or another --indicator",
        FrameError::NoSurface { .. } => {
            "; --indicator cloud keeps drops and sheets that smoothing loses; else use smaller cells, a lower --iso or a smaller \
             --sigma; is the --spacing right?"
        }
        FrameError::NothingLeft(_) => "; a smaller --drop-smaller or --smallest-drop leaves more",
        FrameError::NoDistanceSurface => "; use smaller cells; is the --spacing right?",
        FrameError::NoKernelSurface => "; use smaller cells, or a lower --iso",
        FrameError::NoRoom { .. } => "; name another folder with --scratch, or allow more with --memory",
        _ => "",
    }
}
