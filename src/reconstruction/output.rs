//! Output files that are checked and prepared before the reconstruction starts.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use crate::brick::Census;
use crate::error::Error;
use crate::io::output::{MeshFormat, MeshOutput};
use crate::io::stamp::is_same_file;
use crate::io::whole::{FilledFile, MadeFolders, Replace, WholeFile};
use crate::io::{CoordinateWidth, WriteError, WriteFault};
use crate::surface::mesh::source::MeshSource;
use crate::surface::mesh::source::MeteredMesh;
use crate::system::cancel::{Cancel, UnfinishedOutput};
use crate::system::control::{Control, Stage};
use crate::system::timings::Timings;

use super::SinglePrecision;
use crate::settings::Settings;

/// Temporary files and folders of an output, which are removed if writing fails.
#[derive(Debug)]
pub(crate) struct TemporaryOutput {
    unfinished: UnfinishedOutput,
    /// Folders that were created for the output. The folders are dropped after the temporary file,
    /// which may be inside them.
    _folders: MadeFolders,
}

/// A mesh file that is prepared before the reconstruction starts, and is written completely or not
/// at all.
#[derive(Debug)]
pub struct Output {
    file: MeshOutput,
    temporary: TemporaryOutput,
    path: PathBuf,
}

/// A packed frame that is prepared before the particles are sampled, and is written completely or
/// not at all.
#[derive(Debug)]
pub struct PackedOutput {
    file: WholeFile,
    temporary: TemporaryOutput,
    path: PathBuf,
}

/// A report on a packed frame that was written.
#[derive(Debug)]
#[non_exhaustive]
pub struct PackReport {
    /// The file's size, in bytes.
    pub bytes: u64,
    /// The number of cells that are full because of particles in their own bin.
    pub cells: u64,
    /// The number of stored bricks.
    pub bricks: u64,
    /// Counts of used and skipped particles.
    pub census: Census,
    /// Time of each stage.
    pub timings: Timings,
}

/// Returns an error if two paths name the same file, such as an input and an output.
pub(crate) fn refuse_same_file(path: &Path, other: &Path) -> Result<(), Error> {
    if is_same_file(path, other) {
        Err(Error::SameFile { path: path.to_owned(), other: other.to_owned() })
    } else {
        Ok(())
    }
}

/// The width of coordinates in a file: f64 if f32 would move vertices too far and the format stores
/// f64.
pub(crate) fn coordinate_width(
    precision: SinglePrecision,
    format: MeshFormat,
    path: &Path,
) -> Result<CoordinateWidth, WriteError> {
    match precision {
        SinglePrecision::Enough => Ok(CoordinateWidth::F32),
        SinglePrecision::TooCoarse | SinglePrecision::Exceeded if format.holds_f64() => {
            Ok(CoordinateWidth::F64)
        }
        SinglePrecision::TooCoarse => Ok(CoordinateWidth::F32),
        SinglePrecision::Exceeded => {
            let what = format!(
                "{format} stores coordinates as 32-bit floats, but some coordinates of this mesh \
                 are too large for them; use .ply"
            );
            Err(WriteError::new(path, WriteFault::Unsupported(what)))
        }
    }
}

impl Output {
    /// Checks that a file can be written, and that its format can store what the settings request.
    pub(crate) fn prepare(
        settings: &Settings,
        path: &Path,
        replace: Replace,
        cancel: &Cancel,
    ) -> Result<Self, Error> {
        for solid in settings.solid_files() {
            refuse_same_file(path, Path::new(solid))?;
        }
        let prepare = || {
            let folders = MadeFolders::of(path)?;
            Ok::<_, WriteError>((MeshOutput::prepare(path, replace)?, folders))
        };
        let ((file, folders), unfinished) =
            cancel.guard(prepare, |(file, folders)| file.leftovers(folders))?;
        settings.check_format(path, file.format())?;
        Ok(Self {
            file,
            temporary: TemporaryOutput { unfinished, _folders: folders },
            path: path.to_owned(),
        })
    }

    /// The format that the file's extension implies.
    #[must_use]
    pub fn format(&self) -> MeshFormat {
        self.file.format()
    }

    /// The file's path.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Replaces the layout of the file.
    pub(crate) fn with_layout(mut self, layout: crate::io::glb::GlbLayout) -> Self {
        self.file = self.file.with_layout(layout);
        self
    }

    /// Sets the time of the mesh, in seconds, for formats that store it.
    pub(crate) fn at(mut self, seconds: f64) -> Self {
        self.file = self.file.at(seconds);
        self
    }

    /// Writes a mesh into the temporary file.
    pub(crate) fn fill(
        self,
        mesh: &dyn MeshSource,
        width: CoordinateWidth,
        control: &Control,
    ) -> Result<(FilledFile, TemporaryOutput), Error> {
        let readings = self.file.format().readings(mesh);
        let mesh = MeteredMesh::new(mesh, readings, control, Stage::Writing);
        let file =
            control.during(Stage::Writing, || Ok::<_, Error>(self.file.fill(&mesh, width)?))?;
        Ok((file, self.temporary))
    }

    /// Writes a mesh into the temporary file, and renames that file to its final name.
    pub(crate) fn write(
        self,
        mesh: &dyn MeshSource,
        width: CoordinateWidth,
        control: &Control,
    ) -> Result<u64, Error> {
        let (file, temporary) = self.fill(mesh, width, control)?;
        rename_unless_cancelled(file, &temporary)
    }
}

impl PackedOutput {
    pub(super) fn prepare(path: &Path, replace: Replace, cancel: &Cancel) -> Result<Self, Error> {
        if !crate::io::mnf::is_packed(path) {
            return Err(Error::Request(format!(
                "{}: a packed frame needs the extension .mnf",
                path.display()
            )));
        }
        let prepare = || {
            let folders = MadeFolders::of(path)?;
            Ok::<_, WriteError>((WholeFile::prepare(path, replace)?, folders))
        };
        let ((file, folders), unfinished) =
            cancel.guard(prepare, |(file, folders)| file.leftovers(folders))?;
        Ok(Self {
            file,
            temporary: TemporaryOutput { unfinished, _folders: folders },
            path: path.to_owned(),
        })
    }

    /// The file's path.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    pub(super) fn write(
        self,
        control: &Control,
        content: impl FnOnce(&mut dyn Write) -> io::Result<()> + Send,
    ) -> Result<u64, Error> {
        let file = control.during(Stage::Writing, || Ok::<_, Error>(self.file.fill(content)?))?;
        rename_unless_cancelled(file, &self.temporary)
    }
}

/// Renames a temporary file to its final name, unless the work was cancelled.
fn rename_unless_cancelled(file: FilledFile, temporary: &TemporaryOutput) -> Result<u64, Error> {
    if temporary.unfinished.is_cancelled() {
        return Err(Error::Cancelled);
    }
    Ok(file.keep()?)
}
