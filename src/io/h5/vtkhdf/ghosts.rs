//! Finds the ghosts among the points of VTKHDF. A point is a ghost if all of its cells are flagged.
//!
//! In every array, the cells of all partitions are consecutive. If there are several kinds of
//! cells, the vertices of a partition come before its lines. For each partition, `Offsets` has one
//! entry more than the partition has cells. In a partition with cells other than vertices, all
//! points are kept. Arrays are read in windows.

use std::ops::Range;

use hdf5_reader::group::Group;

use crate::io::cell_types::VERTEX;
use crate::io::ghosts::{VertexCells, VertexPoints, append, is_flag};
use crate::io::h5::file::{H5File, convert_error};
use crate::io::h5::table::{H5Array, RowWindows};
use crate::io::wanted::GHOSTS;
use crate::io::{ReadFault, UnreadPart, malformed};

use super::frame::{FrameRows, count, entries, entry, find_array, sub_group, sum};

/// The arrangement of the cells of a data set.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum CellLayout {
    /// In four groups, one per kind of cells, as in PolyData.
    ByKind,
    /// In one group with an array of types, as in UnstructuredGrid.
    Typed,
}

/// The arrays of cell data that are not flags.
pub(super) fn other_cell_data(root: &Group) -> Result<Vec<UnreadPart>, ReadFault> {
    let Some(data) = sub_group(root, "CellData")? else { return Ok(Vec::new()) };
    let arrays = H5Array::by_name(&data)?.into_iter();
    let others = arrays.filter(|array| !is_flag(&array.name, array.components, array.scalar));
    Ok(others.map(|array| UnreadPart::CellData(array.name)).collect())
}

/// Ranges of the points that are not ghosts. `None` if all points are kept.
pub(super) fn non_ghost_points(
    file: &H5File,
    root: &Group,
    frame: &FrameRows,
    cells: CellLayout,
) -> Result<Option<Vec<Range<usize>>>, ReadFault> {
    let Some(data) = sub_group(root, "CellData")? else { return Ok(None) };
    let mut flags = Vec::new();
    for name in GHOSTS {
        let array = find_array(&data, name)?;
        flags.extend(array.filter(|array| is_flag(name, array.components, array.scalar)));
    }
    let (group, lines) = match cells {
        CellLayout::ByKind => (sub_group(root, "Vertices")?, sub_group(root, "Lines")?),
        CellLayout::Typed => (Some(root.clone()), None),
    };
    let (Some(group), false) = (group, flags.is_empty()) else { return Ok(None) };
    let counts =
        [find_array(&group, "NumberOfCells")?, find_array(&group, "NumberOfConnectivityIds")?];
    let arrays = [find_array(&group, "Offsets")?, find_array(&group, "Connectivity")?];
    let ([Some(_), Some(_)], [Some(ends), Some(corners)]) = (counts, arrays) else {
        return Ok(None);
    };

    let points = frame.points(file, root)?;
    // A number of points that exceeds the file's limit is rejected later, when the points are read.
    if sum(&points)? > file.limit {
        return Ok(None);
    }
    let of_parts = |group: &Group, name: &str| frame.of_parts(file, group, name, 0);
    let (vertices, ids) =
        (of_parts(&group, "NumberOfCells")?, of_parts(&group, "NumberOfConnectivityIds")?);
    let others = match lines {
        Some(lines) => of_parts(&lines, "NumberOfCells")?,
        None => vec![0; vertices.len()],
    };
    let all = [sum(&vertices)?, sum(&ids)?, sum(&others)?];
    if sum(&all)? > file.limit {
        let what = format!(
            "{} cells with {} points are too many for the size of this file",
            all[0], all[1]
        );
        return Err(ReadFault::Compression(what));
    }

    let first = FirstCells::of(file, root, frame, cells)?;
    let end = first.cell.saturating_add(first.parts_before(file, &group, frame, cells)?);
    let types = if cells == CellLayout::Typed { find_array(&group, "Types")? } else { None };
    let mut arrays = Arrays {
        ends: NumberReader::new(ends, end)?,
        types: types.map(|types| NumberReader::new(types, first.cell)).transpose()?,
        corners: NumberReader::new(corners, first.corner)?,
        flags: Vec::new(),
    };
    for array in flags {
        let row = first.row_of_data(file, root, frame, &array.name)?;
        arrays.flags.push(NumberReader::new(array, row)?);
    }
    let (mut non_ghosts, mut base) = (Vec::new(), 0);
    for (index, &points) in points.iter().enumerate() {
        let part = PartitionCounts {
            points: points as usize,
            vertices: vertices[index],
            ids: ids[index],
            others: others[index],
        };
        let number = frame.parts[0] + index as u64;
        match arrays.non_ghost_points(&part).map_err(|fault| in_part(number, fault))? {
            Some(ranges) => ranges
                .into_iter()
                .for_each(|range| append(&mut non_ghosts, base + range.start..base + range.end)),
            None => append(&mut non_ghosts, base..base + part.points),
        }
        base += part.points;
    }
    let all_read = |flags: &&NumberReader| frame.step.is_some() || flags.at == flags.array.rows;
    if let Some(NumberReader { array, at, .. }) = arrays.flags.iter().find(|flags| !all_read(flags))
    {
        let what = format!("array {} must have one number for each of {at} cells", array.name);
        return Err(malformed(0, what));
    }
    Ok(Some(non_ghosts))
}

/// Adds the number of the partition to an error.
fn in_part(part: u64, fault: ReadFault) -> ReadFault {
    match fault {
        ReadFault::Malformed { at, what } => {
            ReadFault::Malformed { at, what: format!("partition {part}: {what}") }
        }
        other => other,
    }
}

/// The rows at which the first cell of a frame is stored in the arrays.
struct FirstCells {
    cell: u64,
    corner: u64,
    /// The row of the first cell's data in arrays whose offset is not stored.
    data: u64,
}

impl FirstCells {
    fn of(
        file: &H5File,
        root: &Group,
        frame: &FrameRows,
        cells: CellLayout,
    ) -> Result<Self, ReadFault> {
        let Some(step) = frame.step else { return Ok(Self { cell: 0, corner: 0, data: 0 }) };
        let steps = convert_error(root.group("Steps"))?;
        let kinds = if cells == CellLayout::ByKind { 4 } else { 1 };
        let of_kinds = |name: &str| entries(file, &steps, name, step, kinds);
        let (cells, corners) = (of_kinds("CellOffsets")?, of_kinds("ConnectivityIdOffsets")?);
        Ok(Self { cell: cells[0], corner: corners[0], data: sum(&cells[..kinds])? })
    }

    /// The number of partitions before this frame that have entries in `Offsets`.
    fn parts_before(
        &self,
        file: &H5File,
        group: &Group,
        frame: &FrameRows,
        cells: CellLayout,
    ) -> Result<u64, ReadFault> {
        let first = frame.parts[0];
        if cells == CellLayout::Typed || first == 0 {
            return Ok(first);
        }
        let before = H5Array::named(group, "NumberOfCells")?.part(0, first)?.integers(file)?;
        let before = before.into_iter().map(|cells| count(cells, "NumberOfCells"));
        let before = before.collect::<Result<Vec<_>, _>>()?;
        if sum(&before)? == self.cell {
            return Ok(first);
        }
        // Steps may share cells or have none. Count only the partitions whose cells are before this
        // frame.
        let mut cells = 0;
        let is_needed = |own: &&u64| {
            let needed = cells < self.cell;
            cells += **own;
            needed
        };
        Ok(before.iter().take_while(is_needed).count() as u64)
    }

    /// The row of the first cell's data in the array `name`.
    fn row_of_data(
        &self,
        file: &H5File,
        root: &Group,
        frame: &FrameRows,
        name: &str,
    ) -> Result<u64, ReadFault> {
        let Some(step) = frame.step else { return Ok(0) };
        let Some(offsets) = sub_group(&convert_error(root.group("Steps"))?, "CellDataOffsets")?
        else {
            return Ok(self.data);
        };
        if find_array(&offsets, name)?.is_some() {
            entry(file, &offsets, name, step)
        } else {
            Ok(self.data)
        }
    }
}

/// The numbers of points and cells in a partition.
struct PartitionCounts {
    points: usize,
    vertices: u64,
    /// Number of point indices in the connectivity of the vertices.
    ids: u64,
    /// Number of cells that follow the vertices.
    others: u64,
}

/// Readers of the arrays of cells, positioned at the next partition.
struct Arrays {
    ends: NumberReader,
    types: Option<NumberReader>,
    corners: NumberReader,
    flags: Vec<NumberReader>,
}

impl Arrays {
    /// Ranges of the points of the next partition that are not ghosts. `None` if all points are
    /// kept.
    fn non_ghost_points(
        &mut self,
        part: &PartitionCounts,
    ) -> Result<Option<Vec<Range<usize>>>, ReadFault> {
        let &PartitionCounts { points, vertices: cells, ids, others } = part;
        let mut all_vertices = cells > 0 && others == 0;
        if all_vertices {
            self.ends.each(cells + 1, |index, end| all_vertices &= end == index as i64)?;
        } else {
            self.ends.skip(cells + 1);
        }
        match &mut self.types {
            Some(types) if all_vertices => {
                types.each(cells, |_, kind| all_vertices &= kind == VERTEX)?
            }
            Some(types) => types.skip(cells),
            None => {}
        }
        if !all_vertices {
            self.flags.iter_mut().for_each(|flags| flags.skip(cells + others));
            self.corners.skip(ids);
            return Ok(None);
        }
        let wrong = |what: String| malformed(0, what);
        let mut vertices = VertexCells::new(cells as usize);
        for array in &mut self.flags {
            let name = array.array.name.clone();
            let mut flags = vertices.flags(&name);
            array.each(cells, |cell, flag| flags.take(cell, flag))?;
            flags.end().map_err(wrong)?;
        }
        let mut corners = VertexPoints::new(&vertices, points);
        self.corners.each(ids, |cell, point| corners.take(cell, point))?;
        corners.kept_ranges().map(Some).map_err(wrong)
    }
}

/// Reads the numbers of an array in order, with one window in memory.
struct NumberReader {
    array: H5Array,
    windows: RowWindows,
    /// The row that is read next.
    at: u64,
    /// The rows that are in memory.
    buffered: Range<u64>,
    /// The numbers in the rows `buffered`.
    numbers: Vec<i64>,
}

impl NumberReader {
    /// Creates a reader that starts at row `first`.
    fn new(array: H5Array, first: u64) -> Result<Self, ReadFault> {
        let first = first.min(array.rows);
        let rows = array.rows - first;
        let array = array.part(first, rows)?;
        Ok(Self { windows: array.windows(), array, at: 0, buffered: 0..0, numbers: Vec::new() })
    }

    fn skip(&mut self, rows: u64) {
        self.at = self.at.saturating_add(rows);
    }

    /// Calls `take` with the index and value of each of the next `rows` numbers.
    fn each(&mut self, rows: u64, mut take: impl FnMut(usize, i64)) -> Result<(), ReadFault> {
        let H5Array { name, rows: all, .. } = &self.array;
        let end = self.at.saturating_add(rows);
        if end > *all {
            let remaining = all.saturating_sub(self.at);
            let what =
                format!("{name} has only {remaining} of the {rows} numbers of this partition");
            return Err(malformed(0, what));
        }
        let mut taken = 0;
        while self.at < end {
            if !self.buffered.contains(&self.at) {
                let [start, stop] = self.windows.rows(self.windows.containing(self.at), *all);
                self.numbers = self.array.some_integers([start, stop])?;
                self.buffered = start..stop;
            }
            let stop = end.min(self.buffered.end);
            for row in self.at - self.buffered.start..stop - self.buffered.start {
                take(taken, self.numbers[row as usize]);
                taken += 1;
            }
            self.at = stop;
        }
        Ok(())
    }
}
