//! Converts errors of the library to Python exceptions with the same message.

use std::io;
use std::iter::successors;
use std::path::Path;

use meniscus::error::{
    FrameError, PartsError, ReadError, SimulationError, WholeMeshError, WriteError, WriteFault,
};
use meniscus::{Cause, Error};
use pyo3::import_exception;
use pyo3::prelude::*;

import_exception!(meniscus._errors, DeviceError);
import_exception!(meniscus._errors, InputError);
import_exception!(meniscus._errors, MeshWarning);

mod base {
    pyo3::import_exception!(meniscus._errors, Error);
}

/// Whether an error becomes a ``FileError``. This is the case if the cause is a file, and not the
/// request.
fn is_of_file(error: &Error) -> bool {
    let exists = |error: &WriteError| {
        matches!(error.fault, WriteFault::Exists | WriteFault::ExistsInSimulation)
    };
    match (error.cause(), error) {
        (Cause::Output, _) => true,
        (_, Error::Write(error)) => exists(error),
        (Cause::Input, Error::Frame { path, .. } | Error::NoSpacing { path, .. }) => path.is_some(),
        (Cause::Input, Error::Selection(_)) => false,
        (cause, _) => cause == Cause::Input,
    }
}

/// Returns the `errno` for an error of the library: EEXIST for an existing output, ENOENT for
/// missing inputs, and otherwise the `errno` of the system error that caused it, if there is one.
fn matching_errno(error: &Error) -> Option<i32> {
    match error {
        Error::Write(WriteError {
            fault: WriteFault::Exists | WriteFault::ExistsInSimulation,
            ..
        }) => Some(libc::EEXIST),
        Error::Simulation(SimulationError::NoFolder(_) | SimulationError::NoMatch(_)) => {
            Some(libc::ENOENT)
        }
        error => successors(Some(error as &dyn std::error::Error), |error| error.source())
            .find_map(|error| error.downcast_ref::<io::Error>())
            .and_then(errno),
    }
}

/// The `errno` that Python uses for an error of the operating system.
#[cfg(unix)]
fn errno(fault: &io::Error) -> Option<i32> {
    fault.raw_os_error()
}

/// The `errno` that Python uses for an error of the operating system. On systems other than Unix,
/// the operating system's error codes differ from those of the C library, which Python uses.
#[cfg(not(unix))]
fn errno(fault: &io::Error) -> Option<i32> {
    match fault.kind() {
        io::ErrorKind::NotFound => Some(libc::ENOENT),
        io::ErrorKind::PermissionDenied => Some(libc::EACCES),
        io::ErrorKind::AlreadyExists => Some(libc::EEXIST),
        io::ErrorKind::StorageFull => Some(libc::ENOSPC),
        _ => None,
    }
}

/// The file or folder that an error concerns.
fn file_of(error: &Error) -> Option<&Path> {
    match error {
        Error::Frame { fault: FrameError::Scratch { folder: path, .. }, .. }
        | Error::Read(ReadError { path, .. })
        | Error::Write(WriteError { path, .. })
        | Error::Mesh { path, .. }
        | Error::Solid { path, .. }
        | Error::Simulation(
            SimulationError::NoFolder(path)
            | SimulationError::Unreadable { path, .. }
            | SimulationError::Io { path, .. },
        )
        | Error::Parts(PartsError::Io { path, .. }) => Some(path),
        Error::Simulation(SimulationError::NoMatch(pattern)) => Some(Path::new(pattern)),
        Error::Frame { path, .. }
        | Error::Picture { path, .. }
        | Error::NoAttribute { path, .. }
        | Error::NoSpacing { path, .. }
        | Error::Sizes { path, .. } => path.as_deref(),
        _ => None,
    }
}

/// Creates a ``FileError``, which is also an instance of Python's class for the system's error, if
/// there is one.
fn file_error(error: &Error, text: &str) -> PyErr {
    Python::attach(|py| {
        let made = || {
            let make = py.import("meniscus._errors")?.getattr("file_error")?;
            make.call1((text, matching_errno(error), file_of(error)))
        };
        made().map_or_else(|fault: PyErr| fault, PyErr::from_value)
    })
}

/// A hint, for errors about existing files, that names the keywords with which a call replaces or
/// keeps these files. Empty for other errors.
fn replace_hint(error: &Error) -> &'static str {
    match error {
        Error::Write(WriteError { fault: WriteFault::Exists, .. }) => {
            "; overwrite=True replaces it"
        }
        Error::Write(WriteError { fault: WriteFault::ExistsInSimulation, .. }) => {
            "; resume=True keeps finished frames, overwrite=True replaces them"
        }
        _ => "",
    }
}

/// Converts an error of the library to the Python exception of its kind.
pub fn exception(error: Error) -> PyErr {
    let text = error.message_with(&|setting| format!("`{}`", setting.name()));
    let text = text + replace_hint(&error);
    match error.cause() {
        Cause::Device => DeviceError::new_err(text),
        _ if matches!(
            error,
            Error::Cancelled | Error::Frame { fault: FrameError::Cancelled, .. }
        ) =>
        {
            other(text)
        }
        _ if matches!(error, Error::WholeMesh(WholeMeshError::TooManyVertices(_))) => other(text),
        _ if is_of_file(&error) => file_error(&error, &text),
        Cause::Request | Cause::Input => InputError::new_err(text),
        _ => other(text),
    }
}

/// Creates an exception of the base class ``meniscus.Error``.
pub fn other(text: impl Into<String>) -> PyErr {
    base::Error::new_err(text.into())
}

/// Issues Python warnings, which may be configured to raise exceptions.
pub fn warn(py: Python<'_>, texts: impl IntoIterator<Item = String>) -> PyResult<()> {
    let mut texts = texts.into_iter().peekable();
    if texts.peek().is_none() {
        return Ok(());
    }
    let warn = py.import("warnings")?.getattr("warn")?;
    let category = py.get_type::<MeshWarning>();
    texts.try_for_each(|text| warn.call1((category.call1((text,))?,)).map(drop))
}
