//! Writes one mesh as an archive, piece by piece. Each array is encoded twice: first to compute its
//! hash, which precedes the array in the file, and then to write its values.

use std::io::{self, Write};
use std::sync::{Mutex, PoisonError};

use crate::io::encode::{write_floats, write_pieces, write_triangles, write_vertices};
use crate::surface::mesh::source::MeshSource;

use super::SampleTime;
use super::archive::{TimeSampling, archive};
use super::content_hash::ContentHasher;
use super::geometry::{AbcArray, AbcSource, arrays, objects, positions};
use super::ogawa::header;

/// Number of triangles whose corner counts are encoded at once.
const COUNTS: u64 = 1 << 12;

/// The lowest and the highest corner that Alembic stores for an empty box.
const EMPTY_BOX: [[f64; 3]; 2] = [[f64::MAX; 3], [f64::MIN; 3]];

/// Writes `mesh` as an archive with one sample.
///
/// Positions are written as f32, and normals as `N`. An attribute `velocity` of three
/// floating-point components is written as `.velocities`. Other attributes are written as values at
/// the vertices, under the names that [`attribute_names`](super::attribute_names) returns. Colours
/// range from 0 to 1.
///
/// # Panics
/// Like [`MeshFormat::write`](crate::io::output::MeshFormat::write).
pub fn write_mesh(out: &mut dyn Write, mesh: &dyn MeshSource, time: SampleTime) -> io::Result<()> {
    let mut bounds = EMPTY_BOX;
    let arrays = arrays(&mesh.outline());
    let (positions, at) = positions(&arrays);
    let mut samples = Vec::new();
    for (array, position) in arrays.into_iter().zip(positions) {
        let mut hasher = ContentHasher::default();
        array.write(&mut hasher, mesh, &mut bounds)?;
        let sample = array.sample(position, hasher.finish());
        samples.push((array, sample));
    }
    let sampling = TimeSampling::at(&[time.seconds()]);
    let frames = [samples];
    let (groups, root) = archive(at, &sampling, |blocks| objects(&frames, blocks));
    out.write_all(&header(root))?;
    let [samples] = &frames;
    for (array, sample) in samples.iter().filter(|(array, _)| array.bytes() > 0) {
        out.write_all(&array.block_length().to_le_bytes())?;
        out.write_all(&sample.digest)?;
        array.write(out, mesh, &mut bounds)?;
    }
    out.write_all(&groups)
}

impl AbcArray {
    /// Writes the values of the array. Positions also update `bounds`.
    fn write(
        &self,
        out: &mut dyn Write,
        mesh: &dyn MeshSource,
        bounds: &mut [[f64; 3]; 2],
    ) -> io::Result<()> {
        match self.source {
            AbcSource::Positions => {
                let found = Mutex::new(EMPTY_BOX);
                write_vertices(out, mesh, |vertices, out| {
                    let [mut low, mut high] = EMPTY_BOX;
                    for point in vertices.positions.iter().map(|point| point.map(|x| x as f32)) {
                        for (axis, x) in point.into_iter().enumerate() {
                            low[axis] = low[axis].min(x.into());
                            high[axis] = high[axis].max(x.into());
                        }
                        out.extend(point.map(f32::to_le_bytes).as_flattened());
                    }
                    let mut all = found.lock().unwrap_or_else(PoisonError::into_inner);
                    for axis in 0..3 {
                        all[0][axis] = all[0][axis].min(low[axis]);
                        all[1][axis] = all[1][axis].max(high[axis]);
                    }
                })?;
                *bounds = found.into_inner().unwrap_or_else(PoisonError::into_inner);
                Ok(())
            }
            AbcSource::Bounds => out.write_all(
                bounds
                    .as_flattened()
                    .iter()
                    .flat_map(|x| x.to_le_bytes())
                    .collect::<Vec<_>>()
                    .as_slice(),
            ),
            // Polygons in Alembic are clockwise as seen from outside, so swap two corners.
            AbcSource::Corners => write_triangles(out, mesh, |triangles, out| {
                for &[a, b, c] in triangles {
                    out.extend(
                        [a, c, b].map(|corner| (corner as i32).to_le_bytes()).as_flattened(),
                    );
                }
            }),
            AbcSource::CornerCounts => {
                write_pieces(out, self.elements.div_ceil(COUNTS) as usize, |piece, out| {
                    let count = COUNTS.min(self.elements - piece as u64 * COUNTS);
                    out.extend(3_i32.to_le_bytes().repeat(count as usize));
                    Ok(())
                })
            }
            AbcSource::Normals => {
                write_floats(out, mesh, |vertices| vertices.normals.as_flattened())
            }
            // The mesh stores an integer as an f32 with the same 32 bits, so `write_floats` writes
            // integers unchanged.
            AbcSource::Attribute(index) => {
                write_floats(out, mesh, |vertices| &vertices.attributes[index])
            }
            AbcSource::Colour(index) => {
                let kind = mesh.attributes()[index].kind;
                write_vertices(out, mesh, |vertices, out| {
                    let shares = vertices.attributes[index].iter().map(|&share| kind.share(share));
                    shares.for_each(|share| out.extend(share.to_le_bytes()));
                })
            }
        }
    }
}
