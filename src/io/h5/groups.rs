//! Finds groups of particles anywhere in a file. A group of particles has data sets with the same
//! number of rows, a table of a compound type, or elements of H5MD.

use std::collections::BTreeSet;
use std::sync::Arc;

use hdf5_reader::group::Group;
use hdf5_reader::{Dataset, Datatype};

use crate::io::columns::{Endian, Scalar};
use crate::io::fields::{Arrangement, Axes, ColumnIndex, NamedArray, arrange};
use crate::io::{ReadFault, malformed};
use crate::particles::AttributeInfo;
use crate::particles::condition::Where;

use super::contents::{self, DEEPEST, MOST_GROUPS};
use super::file::{H5File, convert_error, time_of, times_in};
use super::h5md;
use super::table::{H5Array, H5Table, RowPart, chosen_type, scalar, types};

/// A group, or a table in a group, that contains positions of particles.
pub(super) struct GroupCandidate {
    /// Path relative to the searched group. `/` for the searched group itself.
    path: String,
    group: Group,
    fields: Vec<NamedArray>,
    sources: Vec<FieldStorage>,
    pub arrangement: Arrangement,
}

/// The location of a field's values: a whole data set, or a part of each row of a data set.
struct FieldStorage {
    set: Arc<Dataset>,
    number: (Scalar, Endian),
    member: Option<CompoundMember>,
}

/// The location, in bytes, of a field within each row of a data set.
#[derive(Clone, Copy)]
struct CompoundMember {
    offset: usize,
    stride: usize,
}

impl GroupCandidate {
    /// Number of frames, if the arrays have an axis for frames.
    pub fn frames(&self) -> Option<u64> {
        self.arrangement.frames
    }

    /// Returns an error if the positions in all frames would exceed the limit for the file's data.
    pub fn check_frames(&self, file: &H5File) -> Result<(), ReadFault> {
        let Arrangement { frames, rows, .. } = self.arrangement;
        let bytes = frames.unwrap_or(1).checked_mul(rows.max(1)).and_then(|n| n.checked_mul(12));
        match bytes.is_some_and(|bytes| bytes <= file.limit) {
            true => Ok(()),
            false => Err(ReadFault::Compression(format!(
                "{} frames of {rows} particles are too many for the size of this file",
                frames.unwrap_or(1)
            ))),
        }
    }

    /// The time of frame number `frame`.
    pub fn time(&self, frame: u64) -> Option<f64> {
        match self.frames() {
            None => time_of(&self.group).or_else(|| times_in(&self.group, None)),
            Some(frames) => h5md::time(&self.group, frame)
                .or_else(|| times_in(&self.group, Some((frame, frames)))),
        }
    }

    /// Edge lengths of the box in frame number `frame`, if the group has the structure of H5MD.
    pub fn box_size(&self, frame: u64) -> Option<[f64; 3]> {
        h5md::box_size(&self.group, frame)
    }

    /// The positions and attributes of frame number `frame`.
    pub fn table(&self, frame: u64) -> Result<H5Table, ReadFault> {
        let Arrangement { rows, axes, position, attributes, left_out, .. } = &self.arrangement;
        let arrays = self.fields.iter().zip(&self.sources).zip(axes);
        let arrays: Vec<H5Array> = arrays
            .map(|((field, source), axes)| {
                let part = match (source.member, axes) {
                    (Some(CompoundMember { offset, stride }), _) => {
                        RowPart::Member { offset, stride }
                    }
                    (None, Axes::Particles) => RowPart::Row,
                    (None, Axes::Components) => RowPart::Columns,
                    (None, Axes::Frames) => RowPart::Frame(frame),
                };
                let components = axes.components(&field.shape);
                let set = Arc::clone(&source.set);
                H5Array::of(set, field.name.clone(), source.number, *rows, components, part)
            })
            .collect();
        let places = |places: &[ColumnIndex]| -> Vec<_> {
            places.iter().map(|place| (place.field, place.component)).collect()
        };
        let attributes = attributes.iter().map(|found| {
            let info = AttributeInfo::new(&found.name, found.places.len());
            (info, places(&found.places))
        });
        let attributes: Vec<_> = attributes.collect();
        let position = places(&position.places).try_into().expect("three components");
        let present = match h5md::is_group(&self.group)? {
            true => h5md::present(&arrays, &attributes)?,
            false => None,
        };
        Ok(H5Table { arrays, position, attributes, left_out: left_out.clone(), present })
    }
}

/// The groups and tables below a group that contain positions, in path order.
pub(super) struct GroupSearch {
    pub candidates: Vec<GroupCandidate>,
    /// The first error in a group that has positions but cannot be read.
    fault: Option<ReadFault>,
}

impl GroupSearch {
    /// Searches `root` and all groups below it.
    pub fn of(root: &Group, file: &H5File) -> Result<Self, ReadFault> {
        let mut search = Self { candidates: Vec::new(), fault: None };
        let mut seen = BTreeSet::new();
        // Stack of groups to search. The last group is searched next.
        let mut ahead = vec![(String::new(), root.clone(), 0)];
        while let Some((path, group, depth)) = ahead.pop() {
            if !seen.insert(group.address()) {
                continue;
            }
            if seen.len() > MOST_GROUPS {
                // Groups beyond this limit might also contain positions, so do not ignore them.
                return Err(ReadFault::Unsupported(format!(
                    "the file has more than {MOST_GROUPS} HDF5 groups; copy the particles' group \
                     to a separate file, for example with h5copy"
                )));
            }
            let (mut groups, mut sets) = convert_error(group.members())?;
            groups.sort_by(|a, b| a.name().cmp(b.name()));
            sets.sort_by(|a, b| a.name().cmp(b.name()));
            let elements = h5md::elements(&groups, file)?;
            let joined = |name: &str| match path.as_str() {
                "" => name.to_owned(),
                path => format!("{path}/{name}"),
            };
            let (mut fields, mut tables) = (GroupFields::default(), Vec::new());
            let items = pandas_items(&sets)?;
            for set in sets {
                let name = last_name(set.name()).to_owned();
                match set.dtype() {
                    Datatype::Compound { .. } => tables.push((name, set)),
                    _ => match items.iter().find(|(values, _)| *values == name) {
                        Some((_, items)) => fields.push_block(set, items),
                        None => fields.push(name, set),
                    },
                }
            }
            for (name, set) in elements {
                fields.push(name, set);
            }
            let own = if path.is_empty() { "/".to_owned() } else { path.clone() };
            search.push(own, &group, fields);
            for (name, set) in tables {
                let mut fields = GroupFields::default();
                fields.push_table(set)?;
                search.push(joined(&name), &group, fields);
            }
            // Skip groups such as `#refs#`, in which MATLAB stores references.
            let below = groups.into_iter().rev().filter(|group| !group.name().starts_with('#'));
            if depth < DEEPEST {
                ahead
                    .extend(below.map(|group| (joined(last_name(group.name())), group, depth + 1)));
            }
        }
        Ok(search)
    }

    fn push(&mut self, path: String, group: &Group, fields: GroupFields) {
        let GroupFields { fields, sources } = fields;
        match arrange(&fields) {
            Ok(Some(arrangement)) => {
                let group = group.clone();
                self.candidates.push(GroupCandidate { path, group, fields, sources, arrangement });
            }
            Ok(None) => {}
            Err(fault) => {
                self.fault.get_or_insert(fault);
            }
        }
    }

    /// Returns one candidate, and the names of all candidates.
    ///
    /// This function chooses the only candidate, or the candidate that a condition names. If there
    /// are several candidates and no condition names one, [`chosen_type`] chooses one by its name.
    /// The name of the chosen candidate comes first in the list. The list is empty if there is only
    /// one candidate and no condition names it.
    ///
    /// # Errors
    /// [`ReadFault::Unsupported`] if there are several candidates and a condition names none of
    /// them, or if no condition names one and there is no default. If there is no candidate, this
    /// function returns the error of the first group whose positions cannot be read. If there is no
    /// such group, it returns [`ReadFault::Unsupported`] with the contents of `root`.
    pub fn chosen(
        mut self,
        root: &Group,
        wanted: &[Where],
    ) -> Result<(GroupCandidate, Vec<String>), ReadFault> {
        if self.candidates.is_empty() {
            return Err(match self.fault {
                Some(fault) => fault,
                None => contents::no_position(root)?,
            });
        }
        // Use the last component of a path as the name if no other path ends with this component.
        let last = |path: &str| path.rsplit('/').next().unwrap_or_default().to_owned();
        let paths: Vec<String> = self.candidates.iter().map(|c| c.path.clone()).collect();
        let names = paths.iter().map(|path| {
            let short = last(path);
            let is_unique = paths.iter().filter(|other| last(other) == short).count() == 1;
            if is_unique && !short.is_empty() { short } else { path.clone() }
        });
        let mut names: Vec<String> = names.collect();
        if let [only] = &names[..] {
            // Conditions on `type` may refer to an attribute `type`. Therefore, it is not an error
            // if no condition names the only candidate.
            let called = Where::types(wanted).find(|named| named == only || **named == paths[0]);
            return Ok((
                self.candidates.swap_remove(0),
                called.map(str::to_owned).into_iter().collect(),
            ));
        }
        let by_path = Where::types(wanted)
            .find_map(|named| Some((paths.iter().position(|path| path == named)?, named)));
        let (index, chosen) = match by_path {
            Some((index, path)) => (index, path.to_owned()),
            None => {
                let chosen = chosen_type(&names, wanted)?;
                let index = names.iter().position(|name| *name == chosen).expect("one of them");
                (index, chosen)
            }
        };
        names[index].clone_from(&chosen);
        Ok((self.candidates.swap_remove(index), types(names, &chosen)))
    }
}

/// The fields of a group or of a table.
#[derive(Default)]
struct GroupFields {
    fields: Vec<NamedArray>,
    sources: Vec<FieldStorage>,
}

impl GroupFields {
    fn add(&mut self, name: String, shape: Vec<u64>, source: FieldStorage) {
        self.fields.push(NamedArray { name, shape });
        self.sources.push(source);
    }

    /// Adds a data set if it contains numbers.
    fn push(&mut self, name: String, set: Dataset) {
        if let Some(number) = scalar(set.dtype()).filter(|_| set.ndim() > 0) {
            let shape = set.shape().to_vec();
            self.add(name, shape, FieldStorage { set: Arc::new(set), number, member: None });
        }
    }

    /// Adds a data set that pandas wrote as a block of columns.
    fn push_block(&mut self, set: Dataset, items: &[String]) {
        let (Some(number), &[rows, width]) = (scalar(set.dtype()), set.shape()) else { return };
        if width != items.len() as u64 {
            return;
        }
        let (set, size) = (Arc::new(set), number.0.size());
        for (index, name) in items.iter().enumerate() {
            let member = Some(CompoundMember { offset: index * size, stride: items.len() * size });
            let source = FieldStorage { set: Arc::clone(&set), number, member };
            self.add(name.clone(), vec![rows], source);
        }
    }

    /// Adds the members of a compound type that are numbers or arrays of numbers.
    fn push_table(&mut self, set: Dataset) -> Result<(), ReadFault> {
        let (&[rows], Datatype::Compound { size, .. }) = (set.shape(), set.dtype()) else {
            return Ok(());
        };
        let (stride, kind) = (*size as usize, set.dtype().clone());
        self.push_members(&Arc::new(set), &kind, "", rows, 0, stride)
    }

    fn push_members(
        &mut self,
        set: &Arc<Dataset>,
        kind: &Datatype,
        name: &str,
        rows: u64,
        offset: usize,
        stride: usize,
    ) -> Result<(), ReadFault> {
        let (number, dims) = match kind {
            Datatype::Compound { fields, .. } => {
                for field in fields {
                    let full = match name {
                        "" => field.name.clone(),
                        _ => format!("{name}.{}", field.name),
                    };
                    let offset = offset.saturating_add(field.byte_offset as usize);
                    self.push_members(set, &field.datatype, &full, rows, offset, stride)?;
                }
                return Ok(());
            }
            Datatype::Array { base, dims } => (scalar(base), &dims[..]),
            Datatype::Enum { base, .. } => (scalar(base), &[][..]),
            other => (scalar(other), &[][..]),
        };
        let Some(number) = number else { return Ok(()) };
        let numbers = dims.iter().try_fold(1u64, |product, &size| product.checked_mul(size));
        let end = numbers
            .and_then(|numbers| usize::try_from(numbers).ok()?.checked_mul(number.0.size()))
            .and_then(|bytes| bytes.checked_add(offset));
        if end.is_none_or(|end| end > stride) {
            let what = format!("{name} extends beyond the {stride} bytes of a row");
            return Err(malformed(0, what));
        }
        let shape = [rows].into_iter().chain(dims.iter().copied()).collect();
        let member = Some(CompoundMember { offset, stride });
        self.add(name.to_owned(), shape, FieldStorage { set: Arc::clone(set), number, member });
        Ok(())
    }
}

/// The last component of a path.
pub(super) fn last_name(path: &str) -> &str {
    path.rsplit('/').next().unwrap_or_default()
}

/// The names of the data sets that are blocks of columns in pandas' fixed format, each with the
/// names of its columns.
fn pandas_items(sets: &[Dataset]) -> Result<Vec<(String, Vec<String>)>, ReadFault> {
    let mut all = Vec::new();
    for set in sets {
        let Some(block) = last_name(set.name()).strip_suffix("_items") else { continue };
        let is_text = matches!(set.dtype(), Datatype::String { .. } | Datatype::VarLen { .. });
        if block.starts_with("block") && is_text && set.ndim() == 1 {
            all.push((format!("{block}_values"), convert_error(set.read_strings())?));
        }
    }
    Ok(all)
}
