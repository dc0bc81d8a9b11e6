//! VTK's cell types, which its legacy, XML and HDF5 formats share. A file that has a cell with an
//! area or a volume is a mesh, whatever its format.

/// Type number of a vertex cell.
pub(super) const VERTEX: i64 = 1;
/// Type number of a cell of several vertices. Cells with greater type numbers have a length, an
/// area or a volume.
pub(super) const POLY_VERTEX: i64 = 2;
const LINE: i64 = 3;
/// Type number of a cell of several connected lines.
const POLY_LINE: i64 = 4;
pub(super) const TRIANGLE: i64 = 5;
pub(super) const TRIANGLE_STRIP: i64 = 6;
pub(super) const POLYGON: i64 = 7;
pub(super) const PIXEL: i64 = 8;
pub(super) const QUAD: i64 = 9;

/// Whether cells of this type have an area or a volume. Empty cells, vertices and lines have none.
/// Programs use lines for the bonds between particles and for the paths of particles.
pub(super) fn is_face(kind: i64) -> bool {
    !(0..TRIANGLE).contains(&kind)
}

/// Numbers of cells. Empty cells are not counted.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct CellCounts {
    /// Number of cells with an area or a volume.
    pub faces: u64,
    pub lines: u64,
    pub vertices: u64,
}

impl CellCounts {
    /// Counts a cell of this type.
    pub fn add(&mut self, kind: i64) {
        match kind {
            VERTEX | POLY_VERTEX => self.vertices += 1,
            LINE | POLY_LINE => self.lines += 1,
            kind => self.faces += u64::from(is_face(kind)),
        }
    }

    /// The sums of these counts and the counts of `other`.
    pub fn plus(self, other: Self) -> Self {
        Self {
            faces: self.faces.saturating_add(other.faces),
            lines: self.lines.saturating_add(other.lines),
            vertices: self.vertices.saturating_add(other.vertices),
        }
    }

    /// Whether there are cells, and all of them are lines.
    pub fn are_lines(self) -> bool {
        self.lines > 0 && self.faces == 0 && self.vertices == 0
    }
}
