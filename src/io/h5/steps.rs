//! The steps of H5Part, groups `Step#12` with one data set a quantity, or such data sets at the
//! file's root.

use hdf5_reader::group::Group;

pub(super) use crate::io::error::a_sequence;
use crate::io::names::{Quantity, quantities};
use crate::io::wanted::WantedAttributes;
use crate::io::{ParticleFile, ReadFault, malformed};
use crate::particles::AttributeInfo;

use super::file::{File, checked, time_of};
use super::table::{Array, Place, Table};

/// Prefix of the names of H5Part's groups.
const STEP: &str = "Step#";

/// Reads a step, or what is at the root of a file without steps: data sets of N rows of one or
/// three numbers, of which `x`, `y` and `z`, or one of three columns called `pos`, `position` or
/// the like, hold the position. All other ones of N rows are attributes.
pub fn read_particles(
    file: File,
    step: Option<u64>,
    wanted: WantedAttributes,
) -> Result<ParticleFile, ReadFault> {
    let root = file.root()?;
    let group = match (step, &*steps_in(&root)?) {
        (Some(step), known) => {
            let found = known.iter().find(|(number, _)| *number == step);
            let (_, name) =
                found.ok_or_else(|| ReadFault::Unsupported(format!("there is no {STEP}{step}")))?;
            checked(root.group(name))?
        }
        (None, []) => root.clone(),
        (None, [(_, name)]) => checked(root.group(name))?,
        (None, [(first, _), .., (last, _)]) => return Err(a_sequence(*first, *last)),
    };
    let time = [&group, &root].into_iter().find_map(time_of);
    let table = table(&group)?;
    drop((group, root));
    Ok(ParticleFile { time, ..table.read(file, "HDF5", wanted)? })
}

/// The columns of a group.
fn table(group: &Group) -> Result<Table, ReadFault> {
    let (names, arrays) = arrays(group)?;
    let missing =
        || ReadFault::Unsupported("no data set of positions, such as x, y and z, or pos".into());
    let (position, others) = quantities(&names).ok_or_else(missing)?;
    // Each column's array and component, in the order of the names.
    let places: Vec<Place> =
        (0..).zip(&arrays).flat_map(|(i, a)| (0..a.components).map(move |c| (i, c))).collect();
    let rows = arrays[places[position.columns[0]].0].rows;
    let fits =
        |quantity: &Quantity| quantity.columns.iter().all(|&c| arrays[places[c].0].rows == rows);
    if !fits(&position) {
        return Err(malformed(0, "the data sets of the position differ in length"));
    }
    let places_of =
        |quantity: &Quantity| quantity.columns.iter().map(|&c| places[c]).collect::<Vec<_>>();
    let attributes = others.iter().filter(|quantity| fits(quantity)).map(|quantity| {
        let info =
            AttributeInfo { name: quantity.name.clone(), components: quantity.columns.len() };
        (info, places_of(quantity))
    });
    let attributes = attributes.collect();
    let position = places_of(&position).try_into().expect("found with three");
    Ok(Table { arrays, position, attributes })
}

/// The numbers of the steps, in order; none in a file that has its data sets at the root.
pub fn steps(file: &File) -> Result<Vec<u64>, ReadFault> {
    Ok(steps_in(&file.root()?)?.into_iter().map(|(number, _)| number).collect())
}

fn steps_in(root: &Group) -> Result<Vec<(u64, String)>, ReadFault> {
    let (groups, _) = checked(root.member_names())?;
    let number = |name: String| Some((name.strip_prefix(STEP)?.parse().ok()?, name));
    let mut steps: Vec<(u64, String)> = groups.into_iter().filter_map(number).collect();
    steps.sort_unstable();
    steps.dedup_by_key(|(number, _)| *number);
    Ok(steps)
}

/// All arrays of a group, and the names of their columns.
fn arrays(group: &Group) -> Result<(Vec<String>, Vec<Array>), ReadFault> {
    let mut arrays = Array::by_name(group)?;
    arrays.retain(|array| matches!(array.components, 1 | 3));
    let mut names = Vec::new();
    for Array { name, components, .. } in &arrays {
        match components {
            1 => names.push(name.clone()),
            _ => names.extend(["x", "y", "z"].map(|axis| format!("{name}.{axis}"))),
        }
    }
    Ok((names, arrays))
}
