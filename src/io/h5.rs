//! HDF5: the steps of H5Part, groups `Step#12` with one data set a quantity, or such data sets at the file's root.
//!
//! A step is a frame; `sim.h5part#12` names one of several. The library that parses the file is bounded: no header, chunk
//! or run of rows is read that the file's size does not vouch for.

use bytemuck::NoUninit;
use hdf5_reader::error::Error;
use hdf5_reader::group::Group;
use hdf5_reader::{Dataset, Datatype, H5Type, Hdf5File, OpenOptions, SliceInfo, SliceInfoElem};

use crate::particles::AttributeInfo;

use super::bytes::{Bytes, Unpacked, Unpacking, unpacked_limit};
use super::columns::{Column, ColumnStore, Endian, Rows, Scalar};
use super::names::{Quantity, quantities};
use super::vertices::columns;
use super::{ParticleFile, ReadFault, malformed};

/// Prefix of the names of H5Part's groups.
const STEP: &str = "Step#";
/// Bytes that are decoded at once.
const WINDOW: u64 = 1 << 20;
/// Names under which the time of a step or a file may be stored.
const TIMES: [&str; 4] = ["TimeValue", "time", "Time", "TIME"];

/// Reads a step, or what is at the root of a file without steps: data sets of N rows of one or three numbers, of which `x`, `y` and `z`, or
/// one of three columns called `pos`, `position` or the like, hold the position. All other ones of N
/// rows are attributes.
///
/// # Errors
/// [`ReadFault::Unsupported`] where a step has to be chosen or is not there, and where no position is found;
/// [`ReadFault::Malformed`] for what HDF5 does not allow, and data sets that differ in length; [`ReadFault::Compression`]
/// for a file that unpacks beyond all reason; [`ReadFault::Scratch`] where it is decoded into a scratch file that fails.
pub fn read_particles(
    bytes: Bytes,
    step: Option<u64>,
    unpacking: Unpacking,
) -> Result<ParticleFile, ReadFault> {
    let limit = unpacked_limit(bytes.len() as u64);
    let file = open(bytes, unpacking, limit)?;
    let root = file.root_group().map_err(fault)?;
    let group = match (step, &*steps_in(&root)?) {
        (Some(step), known) => {
            let found = known.iter().find(|(number, _)| *number == step);
            let (_, name) =
                found.ok_or_else(|| ReadFault::Unsupported(format!("there is no {STEP}{step}")))?;
            root.group(name).map_err(fault)?
        }
        (None, []) => root.clone(),
        (None, [(_, name)]) => root.group(name).map_err(fault)?,
        (None, [(first, _), .., (last, _)]) => {
            let what =
                format!("steps {first} to {last}: a sequence; append #{first} to the name for one of them");
            return Err(ReadFault::Unsupported(what));
        }
    };
    let time = [&group, &root].into_iter().find_map(time_of);

    let (names, arrays) = arrays(&group)?;
    let missing = || ReadFault::Unsupported("no data set of positions, such as x, y and z, or pos".into());
    let (position, others) = quantities(&names).ok_or_else(missing)?;
    // Each column's array and component, in the order of the names.
    let places: Vec<(usize, usize)> =
        (0..).zip(&arrays).flat_map(|(i, a)| (0..a.components).map(move |c| (i, c))).collect();
    let rows = arrays[places[position.columns[0]].0].rows;
    let fits = |quantity: &Quantity| quantity.columns.iter().all(|&c| arrays[places[c].0].rows == rows);
    if !fits(&position) {
        return Err(malformed(0, "the data sets of the position differ in length"));
    }
    let mut decoded = Unpacked::new(unpacking);
    let mut all: Vec<Option<Vec<Column>>> = vec![None; arrays.len()];
    let attributes: Vec<Quantity> = others.into_iter().filter(fits).collect();
    for &column in [&position].into_iter().chain(&attributes).flat_map(|quantity| &quantity.columns) {
        let (index, _) = places[column];
        if all[index].is_none() {
            all[index] = Some(arrays[index].decode(&mut decoded, limit)?);
        }
    }
    let columns_of = |quantity: &Quantity| -> Vec<Column> {
        let column = |&column: &usize| {
            let (array, component) = places[column];
            all[array].as_ref().expect("decoded above")[component]
        };
        quantity.columns.iter().map(column).collect()
    };
    let attribute = |quantity: &Quantity| {
        let info = AttributeInfo { name: quantity.name.clone(), components: quantity.columns.len() };
        (info, columns_of(quantity))
    };
    let position = columns_of(&position).try_into().expect("found with three");
    let attributes = attributes.iter().map(attribute).collect();
    let rows = usize::try_from(rows).expect("decoded above");
    let particles = ColumnStore::new(decoded.finish()?, Rows::All(rows), position, attributes);
    Ok(ParticleFile { particles, format: "HDF5", spacing: None, time })
}

/// The numbers of the steps, in order; none in a file that has its data sets at the root.
///
/// # Errors
/// [`ReadFault::Malformed`] for what is no HDF5.
pub fn steps(bytes: Bytes) -> Result<Vec<u64>, ReadFault> {
    let limit = unpacked_limit(bytes.len() as u64);
    let file = open(bytes, Unpacking::in_memory(), limit)?;
    let root = file.root_group().map_err(fault)?;
    Ok(steps_in(&root)?.into_iter().map(|(number, _)| number).collect())
}

fn open(bytes: Bytes, unpacking: Unpacking, limit: u64) -> Result<Hdf5File, ReadFault> {
    let most = usize::try_from(limit).unwrap_or(usize::MAX);
    let options = OpenOptions::default()
        .with_chunk_cache_bytes((unpacking.in_memory / 4).min(WINDOW << 4) as usize)
        .with_max_chunk_bytes(most)
        .with_max_read_bytes(most);
    Hdf5File::from_owner(bytes, options).map_err(fault)
}

fn fault(error: Error) -> ReadFault {
    match error {
        Error::Io(fault) => ReadFault::Io(fault),
        other => malformed(0, other.to_string()),
    }
}

fn steps_in(root: &Group) -> Result<Vec<(u64, String)>, ReadFault> {
    let (groups, _) = root.member_names().map_err(fault)?;
    let number = |name: String| Some((name.strip_prefix(STEP)?.parse().ok()?, name));
    let mut steps: Vec<(u64, String)> = groups.into_iter().filter_map(number).collect();
    steps.sort_unstable();
    steps.dedup_by_key(|(number, _)| *number);
    Ok(steps)
}

fn time_of(group: &Group) -> Option<f64> {
    let named = |name: &&str| group.attribute(name).ok()?.read_as_f64().ok().filter(|time| time.is_finite());
    TIMES.iter().find_map(named)
}

/// A data set of numbers, one row a particle.
struct Array {
    set: Dataset,
    scalar: Scalar,
    rows: u64,
    components: usize,
}

/// All of a group, and the names of their columns.
fn arrays(group: &Group) -> Result<(Vec<String>, Vec<Array>), ReadFault> {
    let (mut names, mut arrays) = (Vec::new(), Vec::new());
    let mut sets = group.datasets().map_err(fault)?;
    sets.sort_by(|a, b| a.name().cmp(b.name()));
    for set in sets {
        let name = set.name().rsplit('/').next().unwrap_or_default().to_owned();
        let components = match *set.shape() {
            [_] => 1,
            [_, components @ (1 | 3)] => components as usize,
            _ => continue,
        };
        let (Some(scalar), rows) = (scalar(set.dtype()), set.shape()[0]) else { continue };
        match components {
            1 => names.push(name),
            _ => names.extend(["x", "y", "z"].map(|axis| format!("{name}.{axis}"))),
        }
        arrays.push(Array { set, scalar, rows, components });
    }
    Ok((names, arrays))
}

fn scalar(kind: &Datatype) -> Option<Scalar> {
    Some(match kind {
        Datatype::FixedPoint { size: 1, signed: true, .. } => Scalar::I8,
        Datatype::FixedPoint { size: 1, signed: false, .. } => Scalar::U8,
        Datatype::FixedPoint { size: 2, signed: true, .. } => Scalar::I16,
        Datatype::FixedPoint { size: 2, signed: false, .. } => Scalar::U16,
        Datatype::FixedPoint { size: 4, signed: true, .. } => Scalar::I32,
        Datatype::FixedPoint { size: 4, signed: false, .. } => Scalar::U32,
        Datatype::FixedPoint { size: 8, signed: true, .. } => Scalar::I64,
        Datatype::FixedPoint { size: 8, signed: false, .. } => Scalar::U64,
        Datatype::FloatingPoint { size: 4, .. } => Scalar::F32,
        Datatype::FloatingPoint { size: 8, .. } => Scalar::F64,
        _ => return None,
    })
}

impl Array {
    /// Appends all rows, and says where their columns are.
    fn decode(&self, decoded: &mut Unpacked, limit: u64) -> Result<Vec<Column>, ReadFault> {
        let Self { scalar, rows, components, .. } = *self;
        let stride = components * scalar.size();
        let end = rows.checked_mul(stride as u64).and_then(|bytes| bytes.checked_add(decoded.len()));
        if end.is_none_or(|end| end > limit) {
            let what = format!("{rows} rows of {} are beyond all reason for this file", self.set.name());
            return Err(ReadFault::Compression(what));
        }
        let start = decoded.len() as usize;
        let window = (WINDOW / stride as u64).max(1);
        for first in (0..rows).step_by(window as usize) {
            let range = [first, rows.min(first + window)];
            match scalar {
                Scalar::I8 => self.rows::<i8>(range, decoded),
                Scalar::U8 => self.rows::<u8>(range, decoded),
                Scalar::I16 => self.rows::<i16>(range, decoded),
                Scalar::U16 => self.rows::<u16>(range, decoded),
                Scalar::I32 => self.rows::<i32>(range, decoded),
                Scalar::U32 => self.rows::<u32>(range, decoded),
                Scalar::I64 => self.rows::<i64>(range, decoded),
                Scalar::U64 => self.rows::<u64>(range, decoded),
                Scalar::F32 => self.rows::<f32>(range, decoded),
                Scalar::F64 => self.rows::<f64>(range, decoded),
            }?;
        }
        let endian = if cfg!(target_endian = "big") { Endian::Big } else { Endian::Little };
        Ok(columns(start, stride, components, scalar, endian))
    }

    fn rows<T: H5Type + NoUninit>(
        &self,
        [start, end]: [u64; 2],
        out: &mut Unpacked,
    ) -> Result<(), ReadFault> {
        let all = SliceInfoElem::Slice { start: 0, end: u64::MAX, step: 1 };
        let mut selections = vec![SliceInfoElem::Slice { start, end, step: 1 }];
        selections.extend((self.set.ndim() > 1).then_some(all));
        let values = self.set.read_slice::<T>(&SliceInfo { selections }).map_err(fault)?;
        let values: Vec<T> = values.iter().cloned().collect();
        let expected = (end - start) as usize * self.components;
        if values.len() != expected {
            return Err(malformed(
                0,
                format!("{} has {} values of {expected}", self.set.name(), values.len()),
            ));
        }
        out.push(bytemuck::cast_slice(&values))
    }
}
