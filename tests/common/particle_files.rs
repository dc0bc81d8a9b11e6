//! Reads the content of an opened particle file into memory.

use meniscus::internals::io::ParticleFile;
use meniscus::internals::particles::Particles;

/// The positions of the particles.
pub fn positions(file: &ParticleFile) -> Vec<[f64; 3]> {
    let mut positions = vec![[f64::NAN; 3]; file.particles.len()];
    file.particles.positions(0, &mut positions);
    positions
}

/// The values of the attribute with this name, particle by particle.
pub fn attribute(file: &ParticleFile, name: &str) -> Vec<f32> {
    let attributes = file.particles.attributes();
    let index = attributes.iter().position(|attribute| attribute.name == name).expect(name);
    let mut values = vec![f32::NAN; file.particles.len() * attributes[index].components];
    file.particles.attribute(index, 0, &mut values);
    values
}
