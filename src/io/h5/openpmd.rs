//! Reads openPMD in HDF5. A species of particles has records, and each component of a record stores
//! the factor that converts its values to SI units.
//!
//! The position of a particle is `position` plus `positionOffset`, which have separate units. The
//! reader converts all values to SI units.

use std::io;

use hdf5_reader::group::Group;

use crate::io::bytes::UnpackBuffer;
use crate::io::columns::{Column, ColumnStore, Endian, ParticleRows, Scalar};
use crate::io::encode::in_order;
use crate::io::error::{ADD_Z, several_steps};
use crate::io::fields::other_shape;
use crate::io::vertices::columns;
use crate::io::wanted::{WantedAttributes, WantedParticles};
use crate::io::{ParticleFile, ReadFault, malformed};
use crate::particles::AttributeInfo;

use super::file::{H5File, convert_error, number, numbers, time_of};
use super::table::{H5Array, RowWindows, chosen_type, fault_of, types};

/// Groups of a species that are not read as attributes of its particles.
const NOT_ATTRIBUTES: [&str; 3] = ["position", "positionOffset", "particlePatches"];
const AXES: [&str; 3] = ["x", "y", "z"];

/// The group that contains all iterations. An attribute of the root contains the path of this
/// group.
fn iterations(root: &Group) -> Result<Group, ReadFault> {
    let base = root.attribute("basePath").and_then(|path| path.read_string());
    let base = base.unwrap_or_else(|_| "/data/%T/".to_owned());
    let path = base.split("%T").next().unwrap_or_default().trim_matches('/').to_owned();
    path.split('/')
        .filter(|name| !name.is_empty())
        .try_fold(root.clone(), |group, name| convert_error(group.group(name)))
}

/// The numbers of the iterations, in ascending order.
pub fn steps(file: &H5File) -> Result<Vec<u64>, ReadFault> {
    let (groups, _) = convert_error(iterations(&file.root()?)?.member_names())?;
    let mut steps: Vec<u64> = groups.iter().filter_map(|name| name.parse().ok()).collect();
    steps.sort_unstable();
    Ok(steps)
}

/// Reads the particles of one species in an iteration: the species that `wanted` names, or else the
/// only species, or else the species that [`chosen_type`] chooses by its name.
pub fn read_particles(
    file: H5File,
    step: Option<u64>,
    wanted: WantedParticles,
) -> Result<ParticleFile, ReadFault> {
    let step = match (step, &*steps(&file)?) {
        (Some(step), known) if known.contains(&step) => step,
        (Some(step), _) => {
            return Err(ReadFault::Unsupported(format!("the file has no iteration {step}")));
        }
        (None, [only]) => *only,
        (None, []) => return Err(malformed(0, "the file has no iterations")),
        (None, [first, .., last]) => return Err(several_steps(*first, *last)),
    };
    let root = file.root()?;
    let (groups, _) = convert_error(iterations(&root)?.member_names())?;
    let name = groups
        .iter()
        .find(|name| name.parse() == Ok(step))
        .expect("the iteration is in the list of steps");
    let iteration = convert_error(iterations(&root)?.group(name))?;
    let time =
        time_of(&iteration).map(|time| time * number(&iteration, "timeUnitSI").unwrap_or(1.0));
    let path = root.attribute("particlesPath").and_then(|path| path.read_string());
    let path = path.unwrap_or_else(|_| "particles/".to_owned());
    let path = path.trim_matches('/');
    let (groups, _) = convert_error(iteration.member_names())?;
    if !groups.iter().any(|group| path.split('/').next() == Some(group)) {
        let what = format!("iteration {step} contains no particles, only meshes");
        return Err(ReadFault::Unsupported(what));
    }
    let all = convert_error(iteration.group(path))?;
    let (known, _) = convert_error(all.member_names())?;
    let kind = chosen_type(&known, wanted.conditions)?;
    let species = convert_error(all.group(&kind))?;
    Ok(ParticleFile {
        time,
        unit_metres: Some(1.0),
        particle_types: types(known, &kind),
        ..particles(&species, &file, wanted.attributes)?
    })
}

/// A component of a record.
struct Component {
    values: RecordValues,
    /// The factor that converts the values to SI units.
    unit: f64,
}

enum RecordValues {
    Stored(Box<H5Array>),
    /// One value for all particles, and the number of particles.
    Constant(f64, u64),
}

impl Component {
    /// Reads a component: a data set, or a group with one value for all particles.
    fn named(group: &Group, name: &str) -> Result<Option<Self>, ReadFault> {
        let (groups, sets) = convert_error(group.member_names())?;
        if sets.iter().any(|set| set == name) {
            let array = H5Array::named(group, name)?;
            let unit =
                array.set.attribute("unitSI").and_then(|unit| unit.read_as_f64()).unwrap_or(1.0);
            return Ok((array.components == 1)
                .then_some(Self { values: RecordValues::Stored(Box::new(array)), unit }));
        }
        if !groups.iter().any(|group| group == name) {
            return Ok(None);
        }
        Ok(Self::constant(&convert_error(group.group(name))?))
    }

    fn constant(group: &Group) -> Option<Self> {
        let value = number(group, "value")?;
        let rows = numbers(group, "shape")?.first().copied().filter(|rows| *rows >= 0.0)? as u64;
        Some(Self {
            values: RecordValues::Constant(value, rows),
            unit: number(group, "unitSI").unwrap_or(1.0),
        })
    }

    fn rows(&self) -> u64 {
        match &self.values {
            RecordValues::Stored(array) => array.rows,
            RecordValues::Constant(_, rows) => *rows,
        }
    }

    /// The values of a range of rows, in SI units.
    fn doubles(&self, rows: [u64; 2]) -> Result<Vec<f64>, ReadFault> {
        let mut values = match &self.values {
            RecordValues::Stored(array) => array.doubles(rows)?,
            RecordValues::Constant(value, _) => vec![*value; (rows[1] - rows[0]) as usize],
        };
        if self.unit != 1.0 {
            values.iter_mut().for_each(|value| *value *= self.unit);
        }
        Ok(values)
    }
}

/// Reads a record with one or three components. `None` for other records.
fn record(species: &Group, name: &str) -> Result<Option<Vec<Component>>, ReadFault> {
    if let Some(scalar) = Component::named(species, name)? {
        return Ok(Some(vec![scalar]));
    }
    let (groups, _) = convert_error(species.member_names())?;
    if !groups.iter().any(|group| group == name) {
        return Ok(None);
    }
    let group = convert_error(species.group(name))?;
    let components: Vec<_> =
        AXES.into_iter().filter_map(|axis| Component::named(&group, axis).transpose()).collect();
    let components = components.into_iter().collect::<Result<Vec<_>, _>>()?;
    Ok((components.len() == 3).then_some(components))
}

fn particles(
    species: &Group,
    file: &H5File,
    wanted: WantedAttributes,
) -> Result<ParticleFile, ReadFault> {
    let position = record(species, "position")?.filter(|position| position.len() == 3);
    let position = position.ok_or_else(|| {
        ReadFault::Unsupported(format!("the file has no positions with three components; {ADD_Z}"))
    })?;
    let rows = position[0].rows();
    let offset = record(species, "positionOffset")?.filter(|offset| offset.len() == 3);
    if position.iter().chain(offset.iter().flatten()).any(|component| component.rows() != rows) {
        return Err(malformed(0, "the components of the position differ in length"));
    }
    let (groups, sets) = convert_error(species.member_names())?;
    let mut names: Vec<String> = groups.into_iter().chain(sets).collect();
    names.retain(|name| !NOT_ATTRIBUTES.contains(&name.as_str()));
    names.sort_unstable();
    let mut decoded = UnpackBuffer::new(file.unpacking);
    let position_columns =
        columns_of(&position, offset.as_deref(), Scalar::F64, file, &mut decoded)?;
    let (mut records, mut left_out) = (Vec::new(), Vec::new());
    for name in names {
        let Some(components) = record(species, &name)? else { continue };
        match components.iter().map(Component::rows).find(|&other| other != rows) {
            None => records.push((AttributeInfo::new(name, components.len()), components)),
            Some(other) => left_out.extend(other_shape(&name, &[other], rows, None)),
        }
    }
    let infos: Vec<AttributeInfo> = records.iter().map(|(info, _)| info.clone()).collect();
    let (mut attributes, mut unread) = (Vec::new(), Vec::new());
    for ((info, components), reads) in records.into_iter().zip(wanted.among(&infos)) {
        if reads {
            attributes
                .push((info, columns_of(&components, None, Scalar::F32, file, &mut decoded)?));
        } else {
            unread.push(info);
        }
    }
    let rows =
        usize::try_from(rows).map_err(|_| malformed(0, "more particles than can be addressed"))?;
    file.check()?;
    let position = position_columns.try_into().expect("three components");
    let store: ColumnStore =
        ColumnStore::new(decoded.finish()?, ParticleRows::All(rows), position, attributes);
    Ok(ParticleFile { unread, left_out, ..ParticleFile::new(store, "openPMD HDF5") })
}

/// Appends the values of `components` to `decoded`, and returns their columns. If `added` is given,
/// each stored value is the sum of the values in `components` and `added`.
fn columns_of(
    components: &[Component],
    added: Option<&[Component]>,
    scalar: Scalar,
    file: &H5File,
    decoded: &mut UnpackBuffer,
) -> Result<Vec<Column>, ReadFault> {
    let rows = components[0].rows();
    let stride = components.len() * scalar.size();
    let end = rows.checked_mul(stride as u64).and_then(|bytes| bytes.checked_add(decoded.len()));
    if end.is_none_or(|end| end > file.limit) {
        return Err(ReadFault::Compression(format!(
            "{rows} particles are too many for the size of this file"
        )));
    }
    let stored = components.iter().find_map(|component| match &component.values {
        RecordValues::Stored(array) => Some(array.windows()),
        RecordValues::Constant(..) => None,
    });
    let windows = stored.unwrap_or_else(|| RowWindows::of(rows, stride as u64));
    let start = decoded.len() as usize;
    let make = |index: usize, out: &mut Vec<u8>| -> io::Result<()> {
        let window = windows.rows(index, rows);
        let mut tuples = vec![0.0; (window[1] - window[0]) as usize * components.len()];
        for components in [Some(components), added].into_iter().flatten() {
            for (axis, component) in components.iter().enumerate() {
                let values = component.doubles(window).map_err(io::Error::other)?;
                for (tuple, value) in tuples.chunks_exact_mut(components.len()).zip(values) {
                    tuple[axis] += value;
                }
            }
        }
        match scalar {
            Scalar::F32 => {
                tuples.iter().for_each(|&value| out.extend((value as f32).to_le_bytes()))
            }
            _ => tuples.iter().for_each(|&value| out.extend(value.to_le_bytes())),
        }
        Ok(())
    };
    in_order(windows.count, make, |bytes| decoded.push(bytes).map_err(io::Error::other))
        .map_err(fault_of)?;
    Ok(columns(start, stride, components.len(), scalar, Endian::Little))
}
