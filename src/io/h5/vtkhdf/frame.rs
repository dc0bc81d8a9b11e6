//! Finds the rows of a frame in VTKHDF: the rows of its step, partition by partition.

use hdf5_reader::group::Group;

use crate::io::error::several_steps;
use crate::io::h5::file::{H5File, convert_error, time_of};
use crate::io::h5::table::{H5Array, H5Table};
use crate::io::{ReadFault, malformed};

/// The rows of a frame in the data sets.
pub(super) struct FrameRows {
    /// The number of the step. `None` for a file without steps.
    pub step: Option<u64>,
    /// The number of the first partition, and the number of the partition after the last.
    pub parts: [u64; 2],
    /// The row of the frame's first point.
    point: u64,
}

impl FrameRows {
    /// All rows of the data sets, as in a file without steps.
    pub fn all(root: &Group) -> Result<Self, ReadFault> {
        let all = H5Array::named(root, "NumberOfPoints")?.rows;
        Ok(Self { step: None, parts: [0, all], point: 0 })
    }

    pub fn of(file: &H5File, root: &Group, step: Option<u64>) -> Result<Self, ReadFault> {
        let whole = Self::all(root)?;
        let [_, all] = whole.parts;
        let step = match (step, step_count(root)?) {
            (None, None) => return Ok(whole),
            (None, Some(1)) => 0,
            (Some(step), Some(steps)) if step < steps => step,
            (None, Some(steps)) if steps > 1 => return Err(several_steps(0, steps - 1)),
            (step, _) => {
                let step =
                    step.map_or("step in the file".to_owned(), |step| format!("step {step}"));
                return Err(ReadFault::Unsupported(format!("there is no {step}")));
            }
        };
        let steps = convert_error(root.group("Steps"))?;
        let at = |name: &str| entry(file, &steps, name, step);
        let first = at("PartOffsets")?;
        let (_, sets) = convert_error(steps.member_names())?;
        let parts =
            if sets.iter().any(|set| set == "NumberOfParts") { at("NumberOfParts")? } else { 1 };
        let end = first.checked_add(parts).filter(|end| *end <= all);
        let end = end.ok_or_else(|| {
            malformed(
                0,
                format!(
                    "a step has {parts} partitions from number {first} on, but the file has only \
                     {all} partitions"
                ),
            )
        })?;
        Ok(Self { step: Some(step), parts: [first, end], point: at("PointOffsets")? })
    }

    /// The number of points in each partition.
    pub fn points(&self, file: &H5File, root: &Group) -> Result<Vec<u64>, ReadFault> {
        self.of_parts(file, root, "NumberOfPoints", 0)
    }

    /// The entries of a data set for the frame's partitions, and the `more` entries that follow.
    pub fn of_parts(
        &self,
        file: &H5File,
        group: &Group,
        name: &str,
        more: u64,
    ) -> Result<Vec<u64>, ReadFault> {
        let [first, end] = self.parts;
        let part = H5Array::named(group, name)?.part(first, end - first + more)?;
        part.integers(file)?.into_iter().map(|value| count(value, name)).collect()
    }

    /// The positions and attributes of the points.
    pub fn table(&self, file: &H5File, root: &Group) -> Result<H5Table, ReadFault> {
        let rows = sum(&self.points(file, root)?)?;
        let mut arrays = vec![H5Array::named(root, "Points")?.part(self.point, rows)?];
        if let Some(data) = sub_group(root, "PointData")? {
            let offsets = match self.step {
                None => None,
                Some(_) => sub_group(&convert_error(root.group("Steps"))?, "PointDataOffsets")?,
            };
            for array in H5Array::all_of(&data)? {
                let first = match (&offsets, self.step) {
                    (Some(offsets), Some(step)) => entry(file, offsets, &array.name, step)?,
                    _ => self.point,
                };
                arrays.push(array.part(first, rows)?);
            }
        }
        let no_points = || malformed(0, "the array Points must have three components");
        H5Table::of_arrays(arrays, "Points").ok_or_else(no_points)
    }

    /// The types of the cells of an UnstructuredGrid. `None` if the file does not contain them. A
    /// file may have fewer types than cells.
    pub fn cell_types(&self, file: &H5File, root: &Group) -> Result<Option<H5Array>, ReadFault> {
        let arrays = [find_array(root, "Types")?, find_array(root, "NumberOfCells")?];
        let [Some(types), Some(_)] = arrays else { return Ok(None) };
        if types.rows == 0 {
            return Ok(None);
        }
        let first = self.first_cell(file, root)?.min(types.rows);
        let cells = sum(&self.of_parts(file, root, "NumberOfCells", 0)?)?;
        let rows = cells.min(types.rows - first);
        let types = types.part(first, rows)?;
        types.check_small(file)?;
        Ok(Some(types))
    }

    /// The row of the frame's first cell in the data sets of an UnstructuredGrid.
    fn first_cell(&self, file: &H5File, root: &Group) -> Result<u64, ReadFault> {
        let Some(step) = self.step else { return Ok(0) };
        let steps = convert_error(root.group("Steps"))?;
        if find_array(&steps, "CellOffsets")?.is_some() {
            return entry(file, &steps, "CellOffsets", step);
        }
        if self.parts[0] == 0 {
            return Ok(0);
        }
        let before = H5Array::named(root, "NumberOfCells")?.part(0, self.parts[0])?;
        let before = before.integers(file)?.into_iter().map(|cells| count(cells, "NumberOfCells"));
        sum(&before.collect::<Result<Vec<_>, _>>()?)
    }

    pub fn time(&self, file: &H5File, root: &Group) -> Result<Option<f64>, ReadFault> {
        let Some(step) = self.step else { return Ok(time_of(root)) };
        let values =
            H5Array::named(&convert_error(root.group("Steps"))?, "Values")?.part(step, 1)?;
        values.check_small(file)?;
        Ok(values.doubles([0, 1])?.first().copied().filter(|time| time.is_finite()))
    }
}

pub(super) fn sum(counts: &[u64]) -> Result<u64, ReadFault> {
    let sum = counts.iter().try_fold(0u64, |sum, &count| sum.checked_add(count));
    sum.ok_or_else(|| malformed(0, "the number of points is too large"))
}

/// The array `name` of a group. `None` if it does not exist, contains no numbers, or has several
/// numbers per row.
pub(super) fn find_array(group: &Group, name: &str) -> Result<Option<H5Array>, ReadFault> {
    let (_, sets) = convert_error(group.member_names())?;
    if !sets.iter().any(|set| set == name) {
        return Ok(None);
    }
    Ok(H5Array::new(convert_error(group.dataset(name))?).filter(|array| array.components == 1))
}

pub(super) fn sub_group(root: &Group, name: &str) -> Result<Option<Group>, ReadFault> {
    let (groups, _) = convert_error(root.member_names())?;
    let there = groups.iter().any(|group| group == name);
    there.then(|| convert_error(root.group(name))).transpose()
}

pub(super) fn integers(file: &H5File, group: &Group, name: &str) -> Result<Vec<i64>, ReadFault> {
    H5Array::named(group, name)?.integers(file)
}

/// Converts a count. Returns an error if it is negative.
pub(super) fn count(value: i64, name: &str) -> Result<u64, ReadFault> {
    u64::try_from(value)
        .map_err(|_| malformed(0, format!("{name} contains {value}, which is negative")))
}

/// The first count in row `index` of a data set.
pub(super) fn entry(
    file: &H5File,
    group: &Group,
    name: &str,
    index: u64,
) -> Result<u64, ReadFault> {
    entries(file, group, name, index, 1).map(|entries| entries[0])
}

/// The counts in row `index` of a data set. A row with fewer than `least` counts is an error.
pub(super) fn entries(
    file: &H5File,
    group: &Group,
    name: &str,
    index: u64,
    least: usize,
) -> Result<Vec<u64>, ReadFault> {
    let entries = H5Array::named(group, name)?.part(index, 1)?.integers(file)?;
    if entries.len() < least {
        return Err(malformed(
            0,
            format!("a row of {name} has {} numbers, expected {least} or more", entries.len()),
        ));
    }
    entries.into_iter().map(|value| count(value, name)).collect()
}

/// The number of steps. `None` for a file without steps.
pub(super) fn step_count(root: &Group) -> Result<Option<u64>, ReadFault> {
    let Some(steps) = sub_group(root, "Steps")? else { return Ok(None) };
    let values = H5Array::named(&steps, "Values")?;
    Ok(Some(values.rows))
}
