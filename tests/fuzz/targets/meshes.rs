//! Fuzzes the readers of meshes, and the writers with unusual meshes.

use std::io;

use meniscus::internals::io::CoordinateWidth;
use meniscus::internals::io::output::MeshFormat;
use meniscus::internals::io::vdb::read_grids;
use meniscus::internals::surface::mesh::source::{Lattice, MeshSource, Outline, Vertices};
use meniscus::mesh::{Mesh, VertexAttribute, check, measure};

use super::Target;
use super::particles::VTU;

/// Defines the target for the reader of a format.
macro_rules! reader {
    ($name:literal, $format:ident, $runs:literal, $seeds:expr, $words:expr) => {{
        let run = |data: &[u8]| read(MeshFormat::$format, data);
        Target { name: $name, runs: $runs, run, seeds: $seeds, words: $words }
    }};
}

pub fn targets() -> Vec<Target> {
    vec![
        reader!("mesh-ply", Ply, 5000, plys, PLY),
        reader!("mesh-obj", Obj, 5000, || written(MeshFormat::Obj), OBJ),
        reader!("mesh-vtk", Vtk, 5000, vtks, VTK),
        reader!("mesh-vtp", Vtp, 3000, || written(MeshFormat::Vtp), VTU),
        reader!("mesh-stl", Stl, 5000, stls, STL),
        reader!("mesh-vtkhdf", VtkHdf, 1000, || written(MeshFormat::VtkHdf), VTKHDF),
        Target { name: "vdb-grids", runs: 5000, run: grids, seeds: vdbs, words: VDB },
        Target {
            name: "mesh-names",
            runs: 10000,
            run: written_and_read,
            seeds: names,
            words: NAMES,
        },
    ]
}

pub const PLY: &[&str] = &[
    "ply\n",
    "format ascii 1.0\n",
    "format binary_big_endian 1.0\n",
    "element vertex ",
    "element face ",
    "property float x\n",
    "property list uchar int vertex_indices\n",
    "property double ",
    "end_header\n",
    "comment ",
    "obj_info ",
    "4294967295",
    "18446744073709551615",
];
pub const VTK: &[&str] = &[
    "ASCII\n",
    "BINARY\n",
    "DATASET POLYDATA\n",
    "DATASET UNSTRUCTURED_GRID\n",
    "POINTS ",
    "CELLS ",
    "CELL_TYPES ",
    "POLYGONS ",
    "VERTICES ",
    "POINT_DATA ",
    "CELL_DATA ",
    "FIELD FieldData ",
    "SCALARS ",
    "VECTORS ",
    "NORMALS ",
    "LOOKUP_TABLE default\n",
    "METADATA\n",
    "OFFSETS vtktypeint64\n",
    "CONNECTIVITY vtktypeint64\n",
    " double\n",
    " bit\n",
    " string\n",
    " vtkIdType\n",
    "vtkGhostType 1 2 unsigned_char\n",
    "18446744073709551615",
];
const STL: &[&str] = &["solid", "facet normal", "outer loop", "vertex", "endfacet"];
const VTKHDF: &[&str] = &["VTKHDF", "Polygons", "Connectivity"];
const VDB: &[&str] =
    &["AffineMap", "ScaleMap", "_HalfFloat", "file_bbox_min", "\u{1e}0", "\0\0\0\0"];
const NAMES: &[&str] = &["nx", "x", "red", "NORMALS", "end_header", "\"", "&", "%20", "\n"];
const OBJ: &[&str] =
    &["v ", "f ", "vn ", "vt ", "//", "-1", "4294967296", "\\\n", "o a\n", "l 1 2\n"];

/// Reads a mesh from arbitrary bytes. The mesh must be valid, and writing and reading must not
/// change it.
fn read(format: MeshFormat, data: &[u8]) {
    let mesh = match format.read(data) {
        Ok(mesh) => mesh,
        Err(fault) => return assert!(!fault.to_string().is_empty()),
    };
    let vertices = mesh.positions.len();
    assert!(mesh.triangles.iter().flatten().all(|&v| (v as usize) < vertices), "missing vertex");
    assert!(mesh.normals.as_ref().is_none_or(|normals| normals.len() == vertices));
    assert!(mesh.attributes.iter().all(|a| a.values.len() == a.components * vertices));
    assert!(!check(&mesh).to_string().is_empty());
    let _ = measure(&mesh);
    let again = round_trip(MeshFormat::Ply, &mesh);
    assert!(again.triangles == mesh.triangles && bits(&again.positions) == bits(&mesh.positions));
}

/// Lists the grids of a .vdb file. Each grid must account for at least 32 bytes of the file.
fn grids(data: &[u8]) {
    match read_grids(data.into()) {
        Ok(grids) => assert!(32 * grids.len() <= data.len(), "too many grids for the file's size"),
        Err(fault) => assert!(!fault.to_string().is_empty()),
    }
}

/// A mesh whose source also provides the lattice of its samples, which .vdb files need.
struct OnLattice(Mesh);

impl MeshSource for OnLattice {
    fn outline(&self) -> Outline {
        let lattice = Some(Lattice { origin: [0.1; 3], step: 0.5 });
        Outline { lattice, ..self.0.outline() }
    }
    fn vertices(&self, piece: usize) -> io::Result<Vertices<'_>> {
        self.0.vertices(piece)
    }
    fn triangles(&self, piece: usize) -> io::Result<Vec<[u64; 3]>> {
        self.0.triangles(piece)
    }
}

fn vdbs() -> Vec<Vec<u8>> {
    let write = |(mesh, zip)| {
        let mut bytes = Vec::new();
        let format = MeshFormat::Vdb { zip };
        format.write(&mut bytes, &OnLattice(mesh), CoordinateWidth::F32).unwrap();
        bytes
    };
    [(Mesh::default(), false), (mesh(), true)].map(write).to_vec()
}

fn bits(positions: &[[f64; 3]]) -> Vec<u64> {
    positions.as_flattened().iter().map(|x| x.to_bits()).collect()
}

/// Writes a mesh, and reads it again.
fn round_trip(format: MeshFormat, mesh: &Mesh) -> Mesh {
    let mut bytes = Vec::new();
    format.write(&mut bytes, mesh, CoordinateWidth::F64).unwrap();
    format
        .read(&bytes)
        .unwrap_or_else(|fault| panic!("{format} cannot read the mesh that it wrote: {fault}"))
}

/// The mesh formats that store the names of attributes.
const NAMING: [MeshFormat; 4] =
    [MeshFormat::Ply, MeshFormat::Vtk, MeshFormat::Vtp, MeshFormat::VtkHdf];

/// Writes and reads a mesh whose attributes have arbitrary names. The names must not change the
/// rest of the mesh. The first byte selects the format.
fn written_and_read(data: &[u8]) {
    let Some((&format, names)) = data.split_first() else { return };
    let format = NAMING[usize::from(format) % NAMING.len()];
    let Ok(names) = str::from_utf8(names) else { return };
    let attribute = |(name, components): (&str, usize)| {
        let values = vec![0.5; 4 * components];
        VertexAttribute::new(name, components, values)
    };
    let mut mesh = mesh();
    mesh.attributes = names.split('\t').zip([1, 3, 2, 4, 9]).map(attribute).collect();
    let again = round_trip(format, &mesh);
    assert_eq!(
        (&again.positions, &again.triangles),
        (&mesh.positions, &mesh.triangles),
        "{format}"
    );
    assert_eq!(again.normals, mesh.normals, "{format}");
}

fn mesh() -> Mesh {
    let positions = vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let triangles = vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]];
    let values = (0..12).map(|i| i as f32).collect();
    let velocity = VertexAttribute::new("velocity", 3, values);
    let density = VertexAttribute::new("density", 1, vec![0.5; 4]);
    Mesh {
        positions,
        triangles,
        normals: Some(vec![[0.0, 0.6, 0.8]; 4]),
        attributes: vec![velocity, density],
    }
}

fn written(format: MeshFormat) -> Vec<Vec<u8>> {
    let write = |width| {
        let mut bytes = Vec::new();
        format.write(&mut bytes, &mesh(), width).unwrap();
        bytes
    };
    vec![write(CoordinateWidth::F32), write(CoordinateWidth::F64)]
}

fn stls() -> Vec<Vec<u8>> {
    let text = "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1e-3 0\nendloop\nendfacet\nendsolid a\n";
    [written(MeshFormat::Stl), vec![text.into()]].concat()
}

pub fn plys() -> Vec<Vec<u8>> {
    let header = "element vertex 3\nproperty float x\nproperty double y\nproperty float z\nproperty uchar c\n\
                  element face 1\nproperty list uchar int vertex_indices\nend_header\n";
    let ascii = format!("ply\nformat ascii 1.0\n{header}0 0 0 9\n1 0 0 9\n0 1 0 9\n3 0 1 2\n");
    let mut big = format!("ply\nformat binary_big_endian 1.0\n{header}").into_bytes();
    for [x, y, z] in [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0_f32]] {
        big.extend(x.to_be_bytes());
        big.extend(f64::from(y).to_be_bytes());
        big.extend(z.to_be_bytes());
        big.push(9);
    }
    big.push(3);
    big.extend([0_i32, 1, 2].into_iter().flat_map(i32::to_be_bytes));
    [written(MeshFormat::Ply), vec![ascii.into_bytes(), big]].concat()
}

pub fn vtks() -> Vec<Vec<u8>> {
    let old = "# vtk DataFile Version 4.1\ntitle\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 2 double\n0 1 2 3 4 5\nCELLS 2 4\n1 0 1 1\n\
               CELL_TYPES 2\n1\n1\nPOINT_DATA 2\nSCALARS id unsigned_int 1\nLOOKUP_TABLE id_table\n7 8\nFIELD FieldData 2\n\
               velocity 3 2 float\n1 2 3 4 5 6\nmass%20density 1 2 float\n1000 9\n";
    let new = "# vtk DataFile Version 5.1\ntitle\nASCII\nDATASET POLYDATA\nFIELD FieldData 1\nTimeValue 1 1 double\n0.5\nPOINTS 3 float\n\
               0 1 2 3 4 5 6 7 9\nMETADATA\nINFORMATION 1\nNAME L2_NORM_RANGE LOCATION vtkDataArray\nDATA 2 0 1\n\n\
               POLYGONS 2 3\nOFFSETS vtktypeint64\n0 3\nCONNECTIVITY vtktypeint64\n0 1 2\nPOINT_DATA 3\nNORMALS n float\n\
               0 0 1 0 0 1 0 0 1\n";
    let ghosts: [&[u8]; 2] = [
        include_bytes!("../../data/simulations/cells_grid_51.vtk"),
        include_bytes!("../../data/simulations/cells_poly_42.vtk"),
    ];
    let ghosts = ghosts.map(<[u8]>::to_vec).to_vec();
    [written(MeshFormat::Vtk), vec![old.into(), new.into()], ghosts].concat()
}

fn names() -> Vec<Vec<u8>> {
    let of = |format: u8, names: &str| [&[format], names.as_bytes()].concat();
    let both =
        |format| ["velocity\tdensity", "mass density\t\u{e9}\t\tx"].map(|names| of(format, names));
    (0..NAMING.len() as u8).flat_map(both).collect()
}
