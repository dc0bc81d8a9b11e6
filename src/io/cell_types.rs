//! VTK's cell types, which its legacy, XML and HDF5 formats share. A file that has a cell with an
//! area or a volume is a mesh, whatever its format.

/// Type number of a vertex cell.
pub(super) const VERTEX: i64 = 1;
/// Type number of a cell of several vertices. Cells with greater type numbers have a length, an
/// area or a volume.
pub(super) const POLY_VERTEX: i64 = 2;
pub(super) const TRIANGLE: i64 = 5;
pub(super) const TRIANGLE_STRIP: i64 = 6;
pub(super) const POLYGON: i64 = 7;
pub(super) const PIXEL: i64 = 8;
pub(super) const QUAD: i64 = 9;

/// Whether cells of this type have an area or a volume. Empty cells, vertices and lines have none.
/// Programs write lines as the bonds or the paths of particles.
pub(super) fn is_face(kind: i64) -> bool {
    !(0..TRIANGLE).contains(&kind)
}
