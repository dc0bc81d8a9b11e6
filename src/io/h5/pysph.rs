//! Reads PySPH's output in HDF5. `particles` has one group for each array of particles.
//! `solver_data` contains the time.

use crate::io::wanted::{TAG, WantedParticles};
use crate::io::{ParticleFile, ReadFault, malformed};
use crate::particles::AttributeInfo;

use super::file::{H5File, convert_error, time_of};
use super::table::{H5Array, H5Table, Place, chosen_type, types};

/// Name of the group that contains the arrays of particles.
pub const PARTICLES: &str = "particles";
/// Name of the group that contains the solver's time.
pub const SOLVER: &str = "solver_data";

/// Reads the particles of the array that `wanted` names, or else of the only array, or else of the
/// array that [`chosen_type`] chooses by its name. Particles with a nonzero `tag` are left out,
/// because they are copies from other processes or for periodic boundaries.
pub fn read_particles(file: H5File, wanted: WantedParticles) -> Result<ParticleFile, ReadFault> {
    let time = time_of(&file.group(SOLVER)?);
    let (known, _) = convert_error(file.group(PARTICLES)?.member_names())?;
    let kind = chosen_type(&known, wanted.conditions)?;
    let arrays = H5Array::by_name(&file.group(&format!("{PARTICLES}/{kind}/arrays"))?)?;
    let file = table(arrays)?.read(file, "PySPH HDF5", wanted.attributes)?;
    let particle_types = types(known, &kind);
    Ok(ParticleFile { time, particle_types, ..file.without(TAG) })
}

/// Makes a table from arrays, which are identified by name: `x`, `y` and `z` are the position, and
/// `u`, `v` and `w` are the velocity.
fn table(arrays: Vec<H5Array>) -> Result<H5Table, ReadFault> {
    let named =
        |name: &str| arrays.iter().position(|array| array.name == name && array.components == 1);
    let vector = |names: [&str; 3]| -> Option<[usize; 3]> {
        let [x, y, z] = names.map(named);
        Some([x?, y?, z?])
    };
    let missing = || malformed(0, "the file has no arrays x, y and z");
    let position = vector(["x", "y", "z"]).ok_or_else(missing)?;
    let rows = arrays[position[0]].rows;
    if position.iter().any(|&axis| arrays[axis].rows != rows) {
        return Err(malformed(0, "x, y and z differ in length"));
    }
    let velocity =
        vector(["u", "v", "w"]).filter(|v| v.iter().all(|&axis| arrays[axis].rows == rows));
    let places = |columns: [usize; 3]| columns.map(|array| -> Place { (array, 0) });
    let velocity = velocity.map(|v| (AttributeInfo::new("velocity", 3), places(v).to_vec()));
    Ok(H5Table::with_others(arrays, places(position), velocity.into_iter().collect()))
}
