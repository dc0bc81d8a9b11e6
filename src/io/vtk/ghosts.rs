//! Points of a legacy .vtk that are left out because their cells are flagged.

use std::ops::Range;

use crate::io::bytes::View;
use crate::io::ghosts::{VERTEX, VertexCells, VertexPoints};
use crate::io::{ReadFault, malformed};

use super::layout::{Array, CellKind, Cells, Corners, Layout};
use super::numbers::each_integer;

/// Ranges of the points that are not left out for their cells; `None` where all are to stay.
pub(super) fn left(bytes: View, layout: &Layout) -> Result<Option<Vec<Range<usize>>>, ReadFault> {
    let corners = match (&layout.vertices, &*layout.cells, layout.has_others) {
        _ if layout.flags.is_empty() => return Ok(None),
        (Some(vertices), [], false) => vertices,
        (None, [Cells { kind: CellKind::Typed, corners }], false) => corners,
        _ => return Ok(None),
    };
    let each =
        |array: &Array, take: &mut dyn FnMut(usize, i64)| each_integer(bytes, layout.ascii, array, take);
    let (cells, mut all_vertices) = (corners.cells(), true);
    let points = match corners {
        // Every other number is a count of points.
        Corners::Counted { stream, .. } => {
            each(stream, &mut |index, number| all_vertices &= index % 2 == 1 || number == 1)?;
            if all_vertices && Some(stream.tuples) != cells.checked_mul(2) {
                let what = format!("{cells} cells of a point each, but {} numbers", stream.tuples);
                return Err(malformed(stream.at, what));
            }
            stream
        }
        Corners::Offsets { offsets, connectivity } => {
            each(offsets, &mut |index, end| all_vertices &= end == index as i64)?;
            connectivity
        }
    };
    if let Some(types) = &layout.cell_types {
        each(types, &mut |_, kind| all_vertices &= kind == VERTEX)?;
    }
    if !all_vertices {
        return Ok(None);
    }
    let mut vertices = VertexCells::new(cells);
    for array in &layout.flags {
        let mut flags = vertices.flags(&array.name);
        each(array, &mut |cell, flag| flags.take(cell, flag))?;
        flags.end().map_err(|what| malformed(array.at, what))?;
    }
    let mut left = VertexPoints::new(&vertices, layout.points.tuples);
    each(points, &mut |index, point| match corners {
        Corners::Counted { .. } if index % 2 == 0 => {}
        Corners::Counted { .. } => left.take(index / 2, point),
        Corners::Offsets { .. } => left.take(index, point),
    })?;
    left.left().map(Some).map_err(|what| malformed(points.at, what))
}
