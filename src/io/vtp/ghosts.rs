//! Points of a .vtp or .vtu that are left out because their cells are flagged.

use std::ops::Range;

use crate::io::bytes::unpacked_limit;
use crate::io::ghosts::{VERTEX, VertexCells, VertexPoints, is_flag};
use crate::io::wanted::GHOSTS;
use crate::io::{ReadFault, malformed};

use super::data::Decoder;
use super::layout::{Array, DataSet, Layout, Section};

/// Ranges of the points that are not left out for their cells; `None` where all are to stay.
pub(super) fn left(layout: &Layout, decoder: &mut Decoder) -> Result<Option<Vec<Range<usize>>>, ReadFault> {
    let found = |section: Section, name: &str| {
        layout.arrays.iter().find(|array| array.section == section && array.name == name)
    };
    let (section, cells) = match layout.data_set {
        // Other cells than vertices come after these.
        DataSet::PolyData => (Section::Verts, layout.vertices),
        DataSet::UnstructuredGrid => (Section::Cells, layout.cells),
    };
    let flags = GHOSTS.iter().filter_map(|name| found(Section::CellData, name));
    let flags: Vec<&Array> =
        flags.filter(|array| is_flag(&array.name, array.components, array.scalar)).collect();
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
    let mut vertices = VertexCells::new(cells);
    for array in flags {
        let mut flags = vertices.flags(&array.name);
        decoder.each_integer(array, |cell, flag| flags.take(cell, flag))?;
        flags.end().map_err(|what| malformed(array.place(), what))?;
    }
    let mut points = VertexPoints::new(&vertices, layout.points);
    decoder.each_integer(corners, |cell, point| points.take(cell, point))?;
    points.left().map(Some).map_err(|what| malformed(corners.place(), what))
}
