//! Reads H5MD. In a group of particles, each element is a group with values, steps and times.

use hdf5_reader::Dataset;
use hdf5_reader::group::Group;

use crate::io::ReadFault;
use crate::particles::AttributeInfo;
use crate::particles::sieve::Sieve;

use super::file::{H5File, convert_error, number_of, numbers};
use super::groups::last_name;
use super::table::{H5Array, Place};

const POSITION: &str = "position";
const VALUE: &str = "value";
const STEP: &str = "step";
const TIME: &str = "time";
/// Name of the element with identifiers of particles. In a frame, a row with identifier -1 is
/// empty.
const ID: &str = "id";
/// Number of rows whose identifiers are read at once.
const WINDOW: u64 = 1 << 16;

/// The elements of `groups`: their names and data sets of values. An element is left out if its
/// steps differ from those of the element `position`.
pub fn elements(groups: &[Group], file: &H5File) -> Result<Vec<(String, Dataset)>, ReadFault> {
    let mut all = Vec::new();
    for group in groups {
        let (_, sets) = convert_error(group.member_names())?;
        if sets.iter().any(|name| name == VALUE) {
            let name = last_name(group.name()).to_owned();
            all.push((name, convert_error(group.dataset(VALUE))?, steps(group, &sets, file)?));
        }
    }
    let expected = all.iter().find(|(name, ..)| name == POSITION).map(|(.., steps)| steps.clone());
    let fits = |steps: &Option<Vec<i64>>| match (steps, expected.as_ref()) {
        (Some(steps), Some(Some(expected))) => steps == expected,
        _ => true,
    };
    let all = all.into_iter().filter(|(.., steps)| fits(steps));
    Ok(all.map(|(name, values, _)| (name, values)).collect())
}

/// The step of each frame of an element. `None` if the file does not store steps.
fn steps(group: &Group, sets: &[String], file: &H5File) -> Result<Option<Vec<i64>>, ReadFault> {
    if !sets.iter().any(|name| name == STEP) {
        return Ok(None);
    }
    let steps = H5Array::new(convert_error(group.dataset(STEP))?);
    let steps = steps.filter(|steps| steps.components == 1 && !steps.scalar.is_float());
    steps.map(|steps| steps.integers(file)).transpose()
}

/// Whether a group of particles has the structure of H5MD.
pub fn is_group(group: &Group) -> Result<bool, ReadFault> {
    let (groups, _) = convert_error(group.member_names())?;
    if !groups.iter().any(|name| name == POSITION) {
        return Ok(false);
    }
    let (_, sets) = convert_error(convert_error(group.group(POSITION))?.member_names())?;
    Ok(sets.iter().any(|name| name == VALUE))
}

/// The time of a frame, as the element `position` stores it.
pub fn time(group: &Group, frame: u64) -> Option<f64> {
    let times = group.group(POSITION).ok()?.dataset(TIME).ok()?;
    let time = match times.ndim() {
        // A single number is the time between consecutive frames.
        0 => number_of(times, 0)? * frame as f64,
        _ => number_of(times, frame)?,
    };
    time.is_finite().then_some(time)
}

/// Edge lengths of the box. `None` if the box is not aligned to the axes or not stored.
pub fn box_size(group: &Group, frame: u64) -> Option<[f64; 3]> {
    let all = group.group("box").ok()?;
    let fixed = || all.dataset("edges").ok();
    let edges = match all.group("edges") {
        Ok(element) => {
            let edges = H5Array::new(element.dataset(VALUE).ok()?)?;
            (frame < edges.rows).then(|| edges.doubles([frame, frame + 1]).ok())??
        }
        Err(_) => match fixed().and_then(H5Array::new) {
            Some(edges) if edges.components == 1 && edges.rows == 3 => {
                edges.doubles([0, 3]).ok()?
            }
            _ => numbers(&all, "edges")?,
        },
    };
    lengths(&edges)
}

/// The edge lengths of a box that is aligned to the axes. `edges` contains three lengths or the
/// components of three vectors.
fn lengths(edges: &[f64]) -> Option<[f64; 3]> {
    let edges = match *edges {
        [x, y, z] | [x, 0.0, 0.0, 0.0, y, 0.0, 0.0, 0.0, z] => [x, y, z],
        _ => return None,
    };
    edges.iter().all(|edge| edge.is_finite() && *edge > 0.0).then_some(edges)
}

/// Selects the rows that contain particles. `None` if all rows contain particles.
pub fn present(
    arrays: &[H5Array],
    attributes: &[(AttributeInfo, Vec<Place>)],
) -> Result<Option<Sieve>, ReadFault> {
    let ids = attributes.iter().find(|(info, places)| info.name == ID && places.len() == 1);
    let Some(array) = ids.map(|(_, places)| &arrays[places[0].0]) else { return Ok(None) };
    if array.scalar.is_float() {
        return Ok(None);
    }
    let mut present = Sieve::none(array.rows as usize);
    for start in (0..array.rows).step_by(WINDOW as usize) {
        let ids = array.some_integers([start, array.rows.min(start + WINDOW)])?;
        let rows = (start as usize..).zip(ids).filter(|(_, id)| *id != -1);
        rows.for_each(|(row, _)| Sieve::set(&mut present, row));
    }
    let present = Sieve::new(present);
    Ok((present.count() as u64 != array.rows).then_some(present))
}

#[cfg(test)]
mod tests {
    use super::lengths;

    #[test]
    fn box_edges_can_be_lengths_or_axis_aligned_vectors() {
        assert_eq!(lengths(&[1.0, 2.0, 3.0]), Some([1.0, 2.0, 3.0]));
        let vectors = [1.0, 0.0, -0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 3.0];
        assert_eq!(lengths(&vectors), Some([1.0, 2.0, 3.0]));
        let tilted = [1.0, 0.5, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 3.0];
        for none in [&tilted[..], &[1.0, 0.0, 3.0], &[1.0, 2.0], &[1.0, f64::NAN, 3.0]] {
            assert_eq!(lengths(none), None, "{none:?}");
        }
    }
}
