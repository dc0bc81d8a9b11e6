//! Tests that the memory for writing a mesh depends on the size of the mesh's pieces, and not on
//! their number. The exception is .stl, for which all positions are kept.

use std::borrow::Cow;
use std::io;

use meniscus::internals::io::CoordinateWidth;
use meniscus::internals::io::alembic::SampleTime;
use meniscus::internals::io::output::MeshFormat;
use meniscus::internals::particles::AttributeInfo;
use meniscus::internals::surface::mesh::source::{MeshSource, Outline, Vertices};

use crate::common::alone::alone;
use crate::memory::peak_of_process;

/// A mesh whose pieces are generated when they are read.
struct Strip {
    pieces: usize,
}

const VERTICES: usize = 1 << 10;
const TRIANGLES: usize = 1 << 11;

impl MeshSource for Strip {
    fn outline(&self) -> Outline {
        Outline {
            vertices: (self.pieces * VERTICES) as u64,
            triangles: (self.pieces * TRIANGLES) as u64,
            normals: true,
            attributes: vec![AttributeInfo::new("velocity", 3)],
            pieces: self.pieces,
            lattice: None,
        }
    }

    fn vertices(&self, piece: usize) -> io::Result<Vertices<'_>> {
        let numbers = piece * VERTICES..(piece + 1) * VERTICES;
        Ok(Vertices {
            positions: numbers.map(|n| [n as f64, 0.1, 0.2]).collect(),
            normals: vec![[0., 1., 0.]; VERTICES].into(),
            attributes: vec![Cow::Owned(vec![0.5; 3 * VERTICES])],
        })
    }
    fn triangles(&self, piece: usize) -> io::Result<Vec<[u64; 3]>> {
        Ok((0..TRIANGLES as u64).map(|n| [n % 1000, n % 999, piece as u64]).collect())
    }
}

#[test]
fn writing_four_times_as_many_pieces_needs_no_more_memory() {
    let name = "mesh_memory::writing_four_times_as_many_pieces_needs_no_more_memory";
    alone(name, write_strips);
}

fn write_strips() {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().expect("two threads");
    let peak = |format: MeshFormat, pieces: usize| {
        peak_of_process(|| {
            pool.install(|| format.write(&mut io::sink(), &Strip { pieces }, CoordinateWidth::F64))
                .expect("a sink accepts all bytes");
        })
    };
    for format in [
        MeshFormat::Ply,
        MeshFormat::Obj,
        MeshFormat::Vtk,
        MeshFormat::Vtp,
        MeshFormat::Stl,
        MeshFormat::Abc(SampleTime::ZERO),
    ] {
        peak(format, 16);
        let [few, many] = [100, 400].map(|pieces| peak(format, pieces));
        let whole = if format.holds_whole_mesh() { 24 * VERTICES * 300 } else { 0 };
        // Writing needs memory for two pieces of the mesh, and for encoding buffers of eight
        // pieces. The buffers take up to 110 bytes per triangle, because they grow by doubling.
        assert!(few - whole / 3 < (8 * 110 + 2 * 100) * TRIANGLES, "{format}: {few} bytes");
        assert!(
            (whole..whole + few / 4 * 5).contains(&many),
            "{format}: {many} bytes for 400 pieces, {few} for 100"
        );
    }
}
