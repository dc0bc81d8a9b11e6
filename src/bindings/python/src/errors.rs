//! Converts errors of the library to Python exceptions with the same message.

use meniscus::error::{FrameError, WholeMeshError, WriteError, WriteFault};
use meniscus::{Cause, Error};
use pyo3::import_exception;
use pyo3::prelude::*;

import_exception!(meniscus._errors, DeviceError);
import_exception!(meniscus._errors, FileError);
import_exception!(meniscus._errors, InputError);
import_exception!(meniscus._errors, MeshWarning);

mod base {
    pyo3::import_exception!(meniscus._errors, Error);
}

/// Whether an error becomes a ``FileError``, because its cause is a file and not the request.
fn is_of_file(error: &Error) -> bool {
    let exists = |error: &WriteError| {
        matches!(error.fault, WriteFault::Exists | WriteFault::ExistsInSimulation)
    };
    match (error.cause(), error) {
        (Cause::Output, _) => true,
        (_, Error::Write(error)) => exists(error),
        (Cause::Input, Error::Frame { path, .. } | Error::NoSpacing { path, .. }) => path.is_some(),
        (cause, _) => cause == Cause::Input,
    }
}

/// Converts an error of the library to the Python exception of its kind.
pub fn exception(error: Error) -> PyErr {
    let text = error.message_with(&|setting| format!("`{}`", setting.name()));
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
        _ if is_of_file(&error) => FileError::new_err(text),
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
