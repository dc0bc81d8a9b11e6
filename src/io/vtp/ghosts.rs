//! Points that are copies or hidden because their cells are: programs that divide cells among pieces flag these, and not the points.
//!
//! A set of particles has vertices for cells, one a point. Where all cells are such, a point is left out if it has cells and all of them
//! are flagged. What other cells say of their corners is no matter of particles, and is passed over.

use std::ops::Range;

use crate::io::bytes::unpacked_limit;
use crate::io::wanted::GHOSTS;
use crate::io::{ReadFault, malformed};

use super::data::Decoder;
use super::layout::{Array, DataSet, Layout, Section};

/// Bits of VTK's flags by which a cell is a copy (1), is there in finer cells (8), or is hidden (32). Others say what is beside it.
const LEFT_OUT: i64 = 1 | 8 | 32;
/// Number of a cell that is a vertex.
const VERTEX: i64 = 1;

/// A truth for each of many.
struct Bits(Vec<u64>);

impl Bits {
    fn new(count: usize) -> Self {
        Self(vec![0; count.div_ceil(64)])
    }

    fn set(&mut self, index: usize) {
        self.0[index / 64] |= 1 << (index % 64);
    }

    fn get(&self, index: usize) -> bool {
        self.0[index / 64] >> (index % 64) & 1 != 0
    }
}

/// Ranges of the points that are not left out for their cells; `None` where all are.
pub(super) fn left(layout: &Layout, decoder: &mut Decoder) -> Result<Option<Vec<Range<usize>>>, ReadFault> {
    let found = |section: Section, name: &str| {
        layout.arrays.iter().find(|array| array.section == section && array.name == name)
    };
    let (section, cells) = match layout.data_set {
        // Other cells than vertices come after these.
        DataSet::PolyData => (Section::Verts, layout.vertices),
        DataSet::UnstructuredGrid => (Section::Cells, layout.cells),
    };
    let is_flag = |array: &&Array| array.components == 1 && !array.scalar.is_float();
    let flags: Vec<&Array> =
        GHOSTS.iter().filter_map(|name| found(Section::CellData, name)).filter(is_flag).collect();
    let corners = [found(section, "connectivity"), found(section, "offsets")];
    let ([Some(corners), Some(ends)], false) = (corners, flags.is_empty() || layout.lines > 0) else {
        return Ok(None);
    };
    // Whoever reads the points refuses more of them than the file can hold.
    if layout.points as u64 > unpacked_limit(layout.bytes.len() as u64) {
        return Ok(None);
    }
    let (mut all_vertices, mut count) = (true, 0);
    decoder.each_integer(ends, |cell, end| {
        all_vertices &= end == cell as i64 + 1;
        count = cell + 1;
    })?;
    if count != cells {
        return Err(malformed(ends.place(), format!("{cells} cells are announced, {count} have an offset")));
    }
    if let (DataSet::UnstructuredGrid, Some(types)) = (layout.data_set, found(section, "types")) {
        decoder.each_integer(types, |_, kind| all_vertices &= kind == VERTEX)?;
    }
    if !all_vertices {
        return Ok(None);
    }
    let mut flagged = Bits::new(cells);
    for array in flags {
        // Levels were counted, before there were bits.
        let mask = if array.name == GHOSTS[0] { LEFT_OUT } else { i64::MAX };
        let mut count = 0;
        decoder.each_integer(array, |cell, flag| {
            count += 1;
            if cell < cells && flag & mask != 0 {
                flagged.set(cell);
            }
        })?;
        if count != cells {
            let what = format!("array {} is not of one number for each of {cells} cells", array.name);
            return Err(malformed(array.place(), what));
        }
    }
    let [mut copies, mut own] = [0; 2].map(|_| Bits::new(layout.points));
    let mut strayed = None;
    decoder.each_integer(corners, |cell, point| match usize::try_from(point) {
        Ok(point) if point < layout.points && cell < cells => {
            if flagged.get(cell) {
                copies.set(point)
            } else {
                own.set(point)
            }
        }
        _ => {
            strayed.get_or_insert((cell, point));
        }
    })?;
    if let Some((cell, point)) = strayed {
        let what = format!("cell {cell} of {cells} names point {point} of {}", layout.points);
        return Err(malformed(corners.place(), what));
    }
    let mut left: Vec<Range<usize>> = Vec::new();
    for point in (0..layout.points).filter(|&point| !copies.get(point) || own.get(point)) {
        match left.last_mut() {
            Some(range) if range.end == point => range.end += 1,
            _ => left.push(point..point + 1),
        }
    }
    Ok(Some(left))
}
