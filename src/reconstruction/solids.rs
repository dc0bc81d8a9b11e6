//! Reads the files of solids, within the memory limit.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::brick::FrameFacts;
use crate::error::{Error, ReadError};
use crate::frame::estimate::SMALLEST_BUDGET;
use crate::grid::units::{MemoryBudget, SolidOffset};
use crate::io::output::read_mesh;
use crate::io::stamp::Stamp;
use crate::settings::Settings;
use crate::surface::solid::Solid;

use super::checked::CheckedRequest;
use super::warning::Warning;

/// Minimum memory, in bytes, to read a mesh file, per byte of the file.
const MEMORY_PER_FILE_BYTE: u64 = 2;
/// The cache of computed distances from solids may take 1 / `CACHE_DIVISOR` of the memory that the
/// solids leave free, but at most `MOST_CACHE` bytes.
const CACHE_DIVISOR: u64 = 32;
const MOST_CACHE: u64 = 64 << 20;
/// The maximum size, in bytes, of the cache for the solids of a single frame. It is smaller than
/// `MOST_CACHE`, because several frames are made at a time, each with its own solids.
const MOST_CACHE_IN_FRAME: u64 = 2 << 20;

impl Settings {
    /// The combined stamp of an input and of the solids.
    pub(crate) fn stamp(&self, input: &Path) -> Result<Stamp, ReadError> {
        let solids = self.solid_files().iter().map(Path::new);
        Stamp::of_all(std::iter::once(input).chain(solids))
    }

    pub(crate) fn solid_files(&self) -> &[String] {
        self.solid.as_deref().unwrap_or_default()
    }
}

impl CheckedRequest {
    /// Adds the requested solids, which are the same in all frames.
    ///
    /// # Errors
    /// The errors of [`with_solids`](Self::with_solids), and [`Error::Threads`] if threads cannot be
    /// started.
    pub(crate) fn at_solids(self) -> Result<Self, Error> {
        let paths = self.settings.solid_files().iter().map(PathBuf::from).collect::<Vec<_>>();
        if paths.is_empty() {
            return Ok(self);
        }
        self.started()?.install(|| self.with_solids(&paths, MOST_CACHE))
    }

    /// Adds the solids of a single frame.
    ///
    /// # Errors
    /// The errors of [`at_solids`](Self::at_solids).
    pub(crate) fn at_solids_of_frame(self, paths: &[PathBuf]) -> Result<Self, Error> {
        self.with_solids(paths, MOST_CACHE_IN_FRAME)
    }

    /// Reads solids, which cache at most `most_cache` bytes of computed distances. The memory of
    /// the solids counts against the budget.
    ///
    /// # Errors
    /// [`Error::Read`] for a file that cannot be read, [`Error::Solid`] for a mesh that cannot be a
    /// solid, [`Error::Unit`] for an invalid offset, and [`Error::LittleMemory`] if the solids do
    /// not fit into the memory limit.
    fn with_solids(mut self, paths: &[PathBuf], most_cache: u64) -> Result<Self, Error> {
        let offset = self.settings.solid_offset.map(SolidOffset::new).transpose()?;
        let room = self.resources.budget.0.saturating_sub(SMALLEST_BUDGET.0);
        let check_room = |bytes: u64| {
            let least = SMALLEST_BUDGET.0.saturating_add(bytes);
            if bytes > room {
                Err(Error::LittleMemory { least, simplifying: None })
            } else {
                Ok(())
            }
        };
        let mut meshes = Vec::new();
        for path in paths {
            let bytes = std::fs::metadata(path).map_or(0, |file| file.len());
            check_room(bytes.saturating_mul(MEMORY_PER_FILE_BYTE))?;
            meshes.push(read_mesh(path)?);
        }
        let solid = Solid::new(meshes, offset.unwrap_or(SolidOffset::DEFAULT))
            .map_err(|(number, fault)| Error::Solid { path: paths[number].clone(), fault })?;
        check_room(solid.bytes())?;
        let cache = ((room - solid.bytes()) / CACHE_DIVISOR).min(most_cache);
        let solid = solid.keeping_distances(cache);
        self.resources.budget = MemoryBudget(self.resources.budget.0 - solid.bytes());
        let turned = solid.turned().iter();
        self.inverted_solids =
            turned.map(|&number| Warning::InvertedSolid(paths[number].clone())).collect();
        self.solid_files = paths.to_vec();
        self.surfacing.solid = Some(Arc::new(solid));
        Ok(self)
    }

    /// Warnings about the solids, for a surface with the cells of `facts`.
    pub(super) fn solid_warnings(&self, facts: &FrameFacts) -> Vec<Warning> {
        let Some(solid) = &self.surfacing.solid else { return Vec::new() };
        let cell_size = facts.grid.cell_size();
        let both_offsets = 2.0 * solid.offset() * facts.spacing.unwrap_or(cell_size);
        let thickness =
            solid.thickness().iter().map(|thickness| (thickness + both_offsets).max(0.0));
        let thin = self.solid_files.iter().zip(thickness);
        let thin = thin.filter(|&(_, thickness)| thickness < cell_size).map(|(path, thickness)| {
            Warning::ThinSolid { path: path.clone(), thickness, cell_size }
        });
        self.inverted_solids.iter().cloned().chain(thin).collect()
    }
}
