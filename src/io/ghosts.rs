//! Finds the points to leave out because all of their cells are flagged as copied, refined or
//! hidden.
//!
//! Programs that divide cells among pieces flag cells, not points. In a set of particles, each cell
//! is a vertex that refers to one point. If all cells are vertices, a point is left out if it has
//! at least one cell and all of its cells are flagged. If there are cells of other types, all flags
//! of cells are ignored. The flags take one bit of memory per cell, and two bits per point.

use std::ops::Range;

use crate::particles::Particles;

use super::ParticleFile;
use super::columns::Scalar;
use super::wanted::GHOSTS;

/// Bits of VTK's flags for a cell that is a copy (1), refined by finer cells (8), or hidden (32).
/// Cells that have only other bits are kept.
const LEFT_OUT: i64 = 1 | 8 | 32;

/// Whether an array of cell data can contain flags.
pub(super) fn is_flag(name: &str, components: usize, scalar: Scalar) -> bool {
    GHOSTS.contains(&name) && components == 1 && !scalar.is_float()
}

/// A list of bits.
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

/// Vertex cells and their flags.
pub(super) struct VertexCells {
    count: usize,
    flagged: Bits,
}

impl VertexCells {
    /// Creates unflagged vertex cells. The caller has checked that the file contains `count` cells.
    pub fn new(count: usize) -> Self {
        Self { count, flagged: Bits::new(count) }
    }

    /// Starts an array of flags, called `name`, with one flag per cell.
    pub fn flags<'a>(&'a mut self, name: &'a str) -> Flags<'a> {
        // The older array, `vtkGhostLevels`, stores levels of copies instead of bits, so any
        // nonzero number means a copy.
        let mask = if name == GHOSTS[0] { LEFT_OUT } else { i64::MAX };
        Flags { vertices: self, name, mask, count: 0 }
    }
}

/// An array of flags. The reader adds the flags one by one.
pub(super) struct Flags<'a> {
    vertices: &'a mut VertexCells,
    name: &'a str,
    mask: i64,
    count: usize,
}

impl Flags<'_> {
    pub fn take(&mut self, cell: usize, flag: i64) {
        self.count += 1;
        if cell < self.vertices.count && flag & self.mask != 0 {
            self.vertices.flagged.set(cell);
        }
    }

    /// Checks that one flag was added per cell.
    pub fn end(self) -> Result<(), String> {
        let cells = self.vertices.count;
        if self.count == cells {
            return Ok(());
        }
        Err(format!("array {} must have one number for each of {cells} cells", self.name))
    }
}

/// The points of the vertex cells. The reader adds the points one by one.
pub(super) struct VertexPoints<'a> {
    vertices: &'a VertexCells,
    points: usize,
    /// Points with a flagged cell.
    flagged: Bits,
    /// Points with an unflagged cell.
    unflagged: Bits,
    count: usize,
    /// The first cell whose point does not exist, and the number of this point.
    first_invalid: Option<(usize, i64)>,
}

impl<'a> VertexPoints<'a> {
    /// Starts to collect the points of `vertices`. The caller has checked that the file contains
    /// `points` points.
    pub fn new(vertices: &'a VertexCells, points: usize) -> Self {
        let [flagged, unflagged] = [0; 2].map(|_| Bits::new(points));
        Self { vertices, points, flagged, unflagged, count: 0, first_invalid: None }
    }

    pub fn take(&mut self, cell: usize, point: i64) {
        self.count += 1;
        match usize::try_from(point) {
            Ok(point) if point < self.points && cell < self.vertices.count => {
                if self.vertices.flagged.get(cell) {
                    self.flagged.set(point)
                } else {
                    self.unflagged.set(point)
                }
            }
            _ => {
                self.first_invalid.get_or_insert((cell, point));
            }
        }
    }

    /// Ranges of the points that are kept, in order. The error describes the invalid cell, or
    /// states that the numbers of cells and points differ.
    pub fn kept_ranges(self) -> Result<Vec<Range<usize>>, String> {
        let (points, cells) = (self.points, self.vertices.count);
        if let Some((cell, point)) = self.first_invalid {
            return Err(format!(
                "cell {cell} refers to point {point}, but there are {cells} cells and {points} \
                 points, numbered from 0"
            ));
        }
        if self.count != cells {
            return Err(format!(
                "{cells} cells refer to {} points; each cell must refer to one point",
                self.count
            ));
        }
        let mut kept = Vec::new();
        let is_kept = |point: &usize| !self.flagged.get(*point) || self.unflagged.get(*point);
        for point in (0..points).filter(is_kept) {
            append(&mut kept, point..point + 1);
        }
        Ok(kept)
    }
}

/// Appends the range `next`, or joins it with the last range if they are adjacent.
pub(super) fn append(ranges: &mut Vec<Range<usize>>, next: Range<usize>) {
    match ranges.last_mut() {
        Some(last) if last.end == next.start => last.end = next.end,
        _ => ranges.push(next),
    }
}

impl ParticleFile {
    /// Keeps the points in the ranges `kept`, or all points if `kept` is `None`. The removed points
    /// are counted as ghosts.
    pub(super) fn with_points(mut self, kept: Option<Vec<Range<usize>>>) -> Self {
        if let Some(kept) = kept {
            let all = self.particles.len();
            self.particles.keep(kept);
            self.ghosts += all - self.particles.len();
        }
        self
    }
}
