//! Running a request: from particles or a file to a surface, in one call or step by step.

use std::path::Path;

use crate::error::Error;
use crate::io::mnf::is_packed;
use crate::io::whole::{Replace, sweep_folder_of};
use crate::particles::Particles;

use super::builder::Reconstruction;
use super::{Frame, OpenedFrame, Output, PackedOutput, Surface};

impl Reconstruction {
    /// Checks everything that can be checked without reading the input.
    ///
    /// # Errors
    /// [`Error::Unit`], [`Error::SettingConflict`], [`Error::Domain`], [`Error::LittleMemory`] and
    /// [`Error::Threads`].
    pub fn check(&self, input: impl AsRef<Path>) -> Result<(), Error> {
        let (checked, input) = (self.checked_without_solids()?, input.as_ref());
        if is_packed(input) { self.settings.check_packed(input) } else { checked.check_indicator() }
    }

    /// Rejects settings that affect only the surface, because they do not apply to packing a frame.
    ///
    /// # Errors
    /// [`Error::SettingConflict`].
    pub fn check_packing(&self) -> Result<(), Error> {
        self.settings.check_packing()
    }

    /// Reconstructs the surface of particles in memory.
    ///
    /// # Errors
    /// [`Error::Unit`] for numbers out of range, [`Error::SettingConflict`] for settings that
    /// exclude each other, [`Error::Domain`], [`Error::NoSpacing`], [`Error::NoAttribute`],
    /// [`Error::Cancelled`], and [`Error::Frame`] for particles that have no surface or do not fit
    /// into memory.
    pub fn run(&self, particles: &(impl Particles + ?Sized)) -> Result<Surface, Error> {
        self.sample(particles)?.surface()
    }

    /// Reconstructs the surface of the particles in a file, or of a packed frame.
    ///
    /// # Errors
    /// [`Error::Read`], and the errors of [`run`](Self::run).
    pub fn run_file(&self, path: impl AsRef<Path>) -> Result<Surface, Error> {
        self.open(path)?.sample()?.surface()
    }

    /// Samples particles in memory once, for several surfaces with different settings.
    ///
    /// # Errors
    /// The errors of [`run`](Self::run).
    pub fn sample(&self, particles: &(impl Particles + ?Sized)) -> Result<Frame, Error> {
        self.checked()?.on_threads()?.sample(&particles)
    }

    /// Opens a particle file or a packed frame.
    ///
    /// # Errors
    /// [`Error::Read`], and those errors of [`run`](Self::run) that occur before the particles are
    /// sampled.
    pub fn open(&self, path: impl AsRef<Path>) -> Result<OpenedFrame, Error> {
        self.open_together(&[path.as_ref()])
    }

    /// Opens several files as one frame, for example the files of several fluids, with the
    /// attributes that all files have.
    ///
    /// # Errors
    /// [`Error::Read`], those errors of [`run`](Self::run) that occur before the particles are
    /// sampled, and [`Error::Request`] if `paths` is empty.
    pub fn open_together(&self, paths: &[impl AsRef<Path>]) -> Result<OpenedFrame, Error> {
        let paths: Vec<&Path> = paths.iter().map(AsRef::as_ref).collect();
        self.checked()?.on_threads()?.open(&paths)
    }

    /// Checks, before the reconstruction, that a mesh file can be written, and that its format can
    /// store what the settings request.
    ///
    /// # Errors
    /// [`Error::Write`], and [`Error::SettingConflict`] for settings that the format cannot store.
    pub fn output(&self, path: impl AsRef<Path>, replace: Replace) -> Result<Output, Error> {
        sweep_folder_of(path.as_ref());
        Output::prepare(&self.settings, path.as_ref(), replace, &self.control.cancel)
    }

    /// Checks, before the particles are sampled, that a packed frame can be written.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn packed_output(
        &self,
        path: impl AsRef<Path>,
        replace: Replace,
    ) -> Result<PackedOutput, Error> {
        sweep_folder_of(path.as_ref());
        PackedOutput::prepare(path.as_ref(), replace, &self.control.cancel)
    }
}
