//! Particles of a file, for callers that process them before making a surface.

use std::path::Path;

use crate::error::Error;
use crate::io::ParticleFile;
use crate::io::bytes::Unpacking;
use crate::io::input::open_wanted;
use crate::io::scene::spacing_from_scene;
use crate::io::wanted::{WantedAttributes, WantedParticles};
use crate::particles::sizes::SizeChoice;
use crate::settings::Settings;
use crate::system::memory::default_memory;

/// Opens a particle file with all its attributes, using the format and the conditions in
/// `settings`. If the file has no spacing, a scene file next to it may provide one.
///
/// ```no_run
/// use meniscus::{Particles, Reconstruction, Settings, files};
///
/// let file = files::open_particles("frame_20.bgeo", &Settings::default())?;
/// let mut positions = vec![[0.0; 3]; file.particles.len()];
/// file.particles.positions(0, &mut positions);
/// positions.retain(|[_, height, _]| *height > 0.0);
/// let surface = Reconstruction::new().run(&positions)?;
/// # Ok::<(), meniscus::Error>(())
/// ```
///
/// # Errors
/// [`Error::Read`] if the file cannot be read, or lacks the requested type of particles.
pub fn open_particles(path: impl AsRef<Path>, settings: &Settings) -> Result<ParticleFile, Error> {
    let (path, scratch) = (path.as_ref(), std::env::temp_dir());
    let unpacking =
        Unpacking { in_memory: default_memory().0 / 8, scratch: &scratch, control: None };
    let wanted = WantedParticles {
        attributes: WantedAttributes::All,
        ..settings.wanted(&SizeChoice::Ignored)
    };
    let mut file = open_wanted(path, wanted, unpacking)?;
    file.spacing = file.spacing.or_else(|| spacing_from_scene(path).map(|(spacing, _)| spacing));
    Ok(file)
}
