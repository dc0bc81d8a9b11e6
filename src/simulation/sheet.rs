//! A sheet of a simulation's frames, beside their meshes.

use std::path::{Path, PathBuf};

use crate::error::Error;
use crate::io::UpAxis;
use crate::io::whole::Replace;
use crate::surface::picture::Picture;

use super::builder::Simulation;
use super::naming::without_number;
use super::pictures::{PictureFile, Pictures};

/// A picture of a simulation's frames, which is drawn of their meshes once they are there.
#[derive(Debug)]
#[must_use]
pub struct Sheet {
    pictures: Pictures,
    path: PathBuf,
}

impl Simulation {
    /// Makes sure, before the work, that a sheet of the frames can be written beside the meshes: called as they are, without their numbers,
    /// or `frames.png`. One that is there already is replaced where the simulation replaces its outputs, or goes on.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn sheet(&self) -> Result<Sheet, Error> {
        let path = beside(&self.output);
        let replace = if self.overwrite || self.resume { Replace::Allow } else { Replace::Refuse };
        if path.exists() {
            drop(PictureFile::prepare(&path, replace)?);
        }
        let settings = &self.request.settings;
        let usual = || self.inputs.first().map_or(UpAxis::Y, |input| settings.usual_up(input));
        let up = settings.up.or(settings.particles_up).unwrap_or_else(usual);
        let picture = Picture::new().up(up).ground(true);
        let pictures = Pictures::new(picture, [&self.output], &path).replace(replace);
        Ok(Sheet { pictures: pictures.cancel(self.request.control.cancel.clone()), path })
    }
}

impl Sheet {
    /// The picture's file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Draws the meshes that there are.
    ///
    /// # Errors
    /// Those of [`Pictures::run`].
    pub fn draw(self) -> Result<(), Error> {
        self.pictures.run(|_| ())
    }
}

/// The sheet's file, by the name of the meshes.
fn beside(output: &Path) -> PathBuf {
    let is_folder = output.is_dir() || output.to_string_lossy().ends_with(std::path::is_separator);
    let stem = if is_folder { None } else { output.file_stem() };
    let stem = stem.map(|stem| stem.to_string_lossy().split('{').next().unwrap_or("").to_owned());
    let name = format!("{}.png", without_number(&stem.unwrap_or_default()));
    let folder = if is_folder { output } else { output.parent().unwrap_or(Path::new("")) };
    folder.join(name)
}
