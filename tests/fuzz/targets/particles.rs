//! Fuzzes the readers of particles.

use std::path::Path;

use meniscus::Where;
use meniscus::internals::io::bytes::{Bytes, Unpacking};
use meniscus::internals::io::input::InputFormat;
use meniscus::internals::io::text_format::TextHint;
use meniscus::internals::io::wanted::{WantedAttributes, WantedParticles};
use meniscus::internals::io::{
    ParticleFile, ReadFault, bgeo, bi4, h5, houdini, json, npy, npz, ply, text_format, vtk, vtp,
};
use meniscus::internals::particles::Particles;
use zip::CompressionMethod;

use super::build::houdini::{
    Codec, Container, Form, Layout, Value, cloud, cubes, geometry, keyed, numeric, strings, text,
};
use super::build::{self, Bi4, VtkXml, tuples};
use super::{Target, meshes};

/// Maximum number of attributes that are read from a file.
const MAX_ATTRIBUTES: usize = 20;

pub fn targets() -> Vec<Target> {
    vec![
        Target {
            name: "bgeo",
            runs: 20000,
            run: |data| read_through(bgeo::read_particles(own(data))),
            seeds: bgeos,
            words: &[],
        },
        Target {
            name: "houdini",
            runs: 20000,
            run: |data| {
                let all = WantedAttributes::All;
                read_through(houdini::read_particles(own(data), all, memory()));
                let _ = houdini::read_mesh(own(data));
            },
            seeds: geometries,
            words: GEOMETRY,
        },
        Target {
            name: "blosc",
            runs: 10000,
            run: |data| {
                let all = WantedAttributes::All;
                read_through(houdini::read_particles(own(data), all, memory()));
            },
            seeds: containers,
            words: &["scf1", "1fcs", "\u{2}\u{1}", "\u{21}\u{4}"],
        },
        Target {
            name: "bi4",
            runs: 10000,
            run: |data| read_through(bi4::read_particles(own(data))),
            seeds: bi4s,
            words: BI4,
        },
        Target {
            name: "npy",
            runs: 20000,
            run: |data| read_through(npy::read_particles(own(data), None)),
            seeds: npys,
            words: NPY,
        },
        Target {
            name: "npz",
            runs: 3000,
            run: |data| read_through(npz::read_particles(own(data), None, memory())),
            seeds: npzs,
            words: NPY,
        },
        Target {
            name: "text",
            runs: 10000,
            run: |data| run_text(data, InputFormat::Csv),
            seeds: tables,
            words: TABLE,
        },
        Target {
            name: "lammps",
            runs: 10000,
            run: |data| run_text(data, InputFormat::Lammps),
            seeds: dumps,
            words: DUMP,
        },
        Target {
            name: "tecplot",
            runs: 10000,
            run: |data| run_text(data, InputFormat::Tecplot),
            seeds: tecplots,
            words: TECPLOT,
        },
        Target {
            name: "json",
            runs: 10000,
            run: |data| read_through(json::read_particles(own(data), memory())),
            seeds: jsons,
            words: &["[", "]", ",", "null", "1e999", "{\"a\":"],
        },
        Target {
            name: "xyz",
            runs: 10000,
            run: |data| run_text(data, InputFormat::Xyz),
            seeds: xyzs,
            words: TABLE,
        },
        Target { name: "ply", runs: 10000, run: run_ply, seeds: meshes::plys, words: meshes::PLY },
        Target { name: "vtk", runs: 10000, run: run_vtk, seeds: meshes::vtks, words: meshes::VTK },
        Target { name: "vtu", runs: 3000, run: run_vtu, seeds: vtus, words: VTU },
        Target { name: "hdf5", runs: 1000, run: run_hdf5, seeds: hdf5s, words: HDF5 },
    ]
}

const GEOMETRY: &[&str] = &[
    "\u{7f}NSJb",
    "\u{7f}bJSN",
    "pointcount",
    "topology",
    "pointref",
    "indices",
    "attributes",
    "pointattributes",
    "numeric",
    "string",
    "strings",
    "values",
    "storage",
    "fpreal16",
    "int64",
    "size",
    "pagesize",
    "packing",
    "constantpageflags",
    "rawpagedata",
    "tuples",
    "arrays",
    "primitives",
    "type",
    "run",
    "runtype",
    "varyingfields",
    "uniformfields",
    "closed",
    "Poly",
    "p_r",
    "s_v",
    "n_p",
    "n_v",
    "r_v",
    "Polygon_run",
    "startvertex",
    "nprimitives",
    "nvertices",
    "nvertices_rle",
    "vertex",
    "Part",
    "PackedGeometry",
    "[]",
    "1e308",
    "18446744073709551615",
];
const BI4: &[&str] = &[
    "CaseNfixed",
    "CaseNmoving",
    "CaseNfloat",
    "CaseNfluid",
    "NpDynamic",
    "Npiece",
    "Piece",
    "Dp",
    "PART_",
    "Pos",
    "Posd",
    "Idp",
    "Idpd",
    "Vel",
    "Rhop",
    "\nARRAY",
    "\nVALUES",
    "\nITEM\n",
];
pub const NPY: &[&str] = &[
    "'descr': ",
    "'fortran_order': ",
    "'shape': ",
    "True",
    "False",
    "'<f4'",
    "'>f8'",
    "'<i8'",
    "'|u1'",
    "'<f2'",
    "(7, 3), }",
    "()",
    "18446744073709551615",
    "pos.npy",
    "vel.npy",
];
const TABLE: &[&str] = &[
    "x,y,z",
    "nan",
    "inf",
    "-inf",
    "1e308",
    "1e-320",
    "# ",
    ";",
    "\r\n",
    "\"Points:0\"",
    "vel:0",
    "[m/s]",
    "\u{feff}",
    ".x",
    "1.#QNAN",
    "-nan(ind)",
    "0.14-270",
    "1,5",
    "*****",
    "\t",
    "'",
    "NA",
    "2\n",
    "O ",
    "Properties=",
    "species:S:1:pos:R:3",
    "Lattice=\"",
];
const DUMP: &[&str] = &[
    "ITEM: ",
    "TIMESTEP\n",
    "TIME\n",
    "NUMBER OF ATOMS\n",
    "BOX BOUNDS xy xz yz",
    "abc origin",
    "ATOMS ",
    "x y z",
    "xsu ysu zsu",
    "1e308",
    "18446744073709551615",
];
const TECPLOT: &[&str] = &[
    "VARIABLES = ",
    "ZONE ",
    "I=",
    "J=18446744073709551615",
    "DATAPACKING=BLOCK",
    "F=POINT",
    "ZONETYPE=",
    "SOLUTIONTIME=",
    "DT=(",
    "\"",
    "5*1",
];
pub const VTU: &[&str] = &[
    "<DataArray ",
    "</DataArray>",
    "<Piece ",
    "<Points>",
    "</Points>",
    "<PointData>",
    "NumberOfPoints=\"",
    "NumberOfComponents=\"",
    "format=\"ascii\"",
    "format=\"binary\"",
    "format=\"appended\"",
    "offset=\"",
    "type=\"Float64\"",
    "type=\"Int8\"",
    "type=\"UInt64\"",
    "Name=\"Points\"",
    "Name=\"vtkGhostType\"",
    "compressor=\"vtkZLibDataCompressor\"",
    "header_type=\"UInt64\"",
    "byte_order=\"BigEndian\"",
    "<AppendedData encoding=\"raw\">_",
    "<!--",
    "-->",
    "<![CDATA[",
    "]]>",
    "&amp;",
    "<Polys>",
    "<Verts>",
];
const HDF5: &[&str] = &[
    "\u{89}HDF",
    "TREE",
    "SNOD",
    "HEAP",
    "GCOL",
    "OHDR",
    "OCHK",
    "FRHP",
    "BTHD",
    "FSSE",
    "VTKHDF",
    "Points",
    "Steps",
    "CellData",
    "vtkGhostType",
    "PartType0",
    "Coordinates",
    "Header",
    "NumPart_ThisFile",
    "openPMD",
    "position",
    "particles",
    "solver_data",
    "Step#1",
];

/// Settings that unpack files in memory, without a limit.
pub fn memory() -> Unpacking<'static> {
    Unpacking::in_memory()
}

pub fn own(data: &[u8]) -> Bytes {
    data.to_vec().into()
}

/// Reads all numbers of a file, and then reads the numbers of the second half of the particles
/// again. Both readings must give the same numbers.
pub fn read_through(read: Result<ParticleFile, ReadFault>) {
    let file = match read {
        Ok(file) => file,
        Err(fault) => return assert!(!fault.to_string().is_empty()),
    };
    let particles = &file.particles;
    let (count, half) = (particles.len(), particles.len() / 2);
    let (mut all, mut rest) = (vec![[0.0; 3]; count], vec![[0.0; 3]; count - half]);
    particles.positions(0, &mut all);
    particles.positions(half, &mut rest);
    let bits = |positions: &[[f64; 3]]| -> Vec<u64> {
        positions.as_flattened().iter().map(|x| x.to_bits()).collect()
    };
    assert_eq!(bits(&all[half..]), bits(&rest), "positions differ when they are read again");
    for (index, info) in particles.attributes().iter().enumerate().take(MAX_ATTRIBUTES) {
        let (mut all, mut rest) = (
            vec![0.0_f32; count * info.components],
            vec![0.0_f32; (count - half) * info.components],
        );
        particles.attribute(index, 0, &mut all);
        particles.attribute(index, half, &mut rest);
        let bits = |values: &[f32]| -> Vec<u32> { values.iter().map(|x| x.to_bits()).collect() };
        assert_eq!(
            bits(&all[half * info.components..]),
            bits(&rest),
            "{} differs when it is read again",
            info.name
        );
    }
    let _ = particles.check();
}

fn run_text(data: &[u8], format: InputFormat) {
    let (all, hint) = (WantedAttributes::All, TextHint::Extension(Some(format)));
    let steps = text_format::steps(own(data), hint).unwrap_or_default();
    for step in [None, steps.last().copied()] {
        let read = text_format::read_particles(own(data), hint, (None, step), all, memory());
        read_through(read);
    }
    let named = TextHint::Named(format);
    let step = steps.first().copied();
    read_through(text_format::read_particles(own(data), named, (None, step), all, memory()));
}

fn run_ply(data: &[u8]) {
    read_through(ply::read_points(own(data), memory()));
    let _ = ply::has_faces(data.into());
}

fn run_vtk(data: &[u8]) {
    read_through(vtk::read_points(own(data), memory()));
    let _ = (vtk::has_faces(data.into()), vtk::is_text(data.into()));
}

fn run_vtu(data: &[u8]) {
    read_through(vtp::read_particles(own(data), memory()));
    let _ = (vtp::has_faces(data.into()), vtp::is_text(data.into()));
}

/// Reads an HDF5 file. The first byte selects the step and the type of particles.
fn run_hdf5(data: &[u8]) {
    let Some((choice, data)) = data.split_first() else { return };
    let step = u64::from(choice & 3).checked_sub(1);
    let types = [None, Some("type=0"), Some("type=fluid"), Some("type=PartType1")];
    let conditions: Vec<Where> = types[usize::from(choice >> 2 & 3)]
        .into_iter()
        .map(|condition| condition.parse().expect("a valid condition"))
        .collect();
    let wanted = WantedParticles { conditions: &conditions, ..WantedParticles::default() };
    let read = h5::open_particles(Path::new("nowhere/a_0.hdf5"), own(data), step, wanted, memory());
    read_through(read.map_err(|error| error.fault));
    let _ = (h5::steps(own(data)), h5::has_faces(own(data)));
}

fn bgeos() -> Vec<Vec<u8>> {
    vec![build::bgeo(&tuples(3)), build::bgeo(&[])]
}

fn geometries() -> Vec<Vec<u8>> {
    let position = |layout| numeric("P", "fpreal32", 4, &[0.5; 12], &layout);
    let whole = geometry(
        3,
        vec![
            position(Layout::Pages(2, vec![3, 1])),
            numeric("v", "fpreal16", 3, tuples(3).as_flattened(), &Layout::Tuples),
            strings("name", &["a", "b"], &[0.0, -1.0, 1.0], &Layout::Arrays),
        ],
        &[0.0, 1.0],
        vec![Value::List(vec![
            keyed(vec![("type", text("Poly"))]),
            keyed(vec![("vertex", Value::Numbers("int32", vec![0.0, 1.0]))]),
        ])],
    );
    let plain = cloud(3, vec![position(Layout::Arrays)]);
    let documents = |value: Value| Form::ALL.map(|form| value.document(form));
    [whole, plain].into_iter().chain(cubes()).flat_map(documents).collect()
}

fn containers() -> Vec<Vec<u8>> {
    let p = numeric("P", "fpreal32", 3, tuples(60).as_flattened(), &Layout::Pages(64, vec![3]));
    let document = cloud(60, vec![p]).document(Form::ALL[1]);
    let packed = [Codec::Stored, Codec::Lz4, Codec::Zlib, Codec::Zstd].map(|codec| {
        Container { codec, chunk: 800, block: 512, ..Container::USUAL }.pack(&document)
    });
    packed.to_vec()
}

fn bi4s() -> Vec<Vec<u8>> {
    let layout = |bits: u32| {
        let [big, wide, double, mixed] = [0, 1, 2, 3].map(|bit| bits >> bit & 1 == 1);
        Bi4 { big, wide, double, mixed, pieces: 1, piece: 0 }
    };
    (0..16).map(|bits| layout(bits).build(&tuples(7))).collect()
}

pub fn npys() -> Vec<Vec<u8>> {
    let kinds = ["<f4", "<f8", ">f4", ">f8"];
    kinds
        .into_iter()
        .flat_map(|descr| [false, true].map(|fortran| build::npy(&tuples(3), descr, fortran)))
        .collect()
}

fn npzs() -> Vec<Vec<u8>> {
    [CompressionMethod::Stored, CompressionMethod::Deflated]
        .map(|how| build::npz_frame(&tuples(3), how))
        .to_vec()
}

fn tables() -> Vec<Vec<u8>> {
    let tables = [
        "x,y,z,vel:0,vel:1,vel:2,rho\n1,2,3,4,5,6,7\n# note\n1e3,-.5,nan,4,5,6,7\n",
        "TimeStep [s];Np;Nbound\n0.5;2;0\n\nPos.x [m];Pos.y [m];Pos.z [m];Idp;Vel.x [m/s];Vel.y [m/s];Vel.z [m/s];\n1;2;3;10;4;5;6;\n",
        "\u{feff}# by hand\n1 2 3\n\n4\t5  -6e-1 # end\n",
        "\"Points:0\",\"Points:1\",\"Points:2\"\n1,2,3\n4,5,-0.6\n",
        "x;y;z;name\n[m];[m];[m];\n0,5;1,5D-1;1.#QNAN;\"a;b\"\n0,14-270;;NA;\n",
        "\u{feff}0.5\t1\t2\n",
    ];
    tables.map(|table| table.as_bytes().to_vec()).to_vec()
}

fn dumps() -> Vec<Vec<u8>> {
    let step = |bounds: &str, columns: &str| {
        format!(
            "ITEM: TIMESTEP\n7\nITEM: NUMBER OF ATOMS\n2\nITEM: BOX BOUNDS {bounds}\n\
             ITEM: ATOMS id {columns} vx vy vz\n1 0.1 0.2 0.3 4 5 6\n2 0.5 0.6 0.7 1 2 3\n"
        )
    };
    let plain = step("pp pp pp\n0 1\n0 2\n0 3", "x y z");
    let scaled = step("xy xz yz pp pp pp\n0 1 0.5\n0 2 0\n0 3 -0.5", "xs ys zs");
    let general = step("abc origin pp pp pp\n1 0 0 0\n0 1 0 0\n0 0 1 0", "xsu ysu zsu");
    let both = plain.clone() + &scaled.replacen('7', "8", 1);
    [plain, scaled, general, both].map(String::into_bytes).to_vec()
}

fn tecplots() -> Vec<Vec<u8>> {
    let head = "TITLE = \"a\"\nVARIABLES = \"x\", \"y\" \"z\" \"p\"\nZONE T=\"b\", I=2, J=1, ";
    [
        "DATAPACKING=POINT, DT=(SINGLE)\n1 2 3 10\n4 5 6 20\n",
        "F=BLOCK, SOLUTIONTIME=0.5\n1 4 2 5 3 6 10 20\n",
    ]
    .map(|zone| format!("{head}{zone}").into_bytes())
    .to_vec()
}

fn jsons() -> Vec<Vec<u8>> {
    ["[[1, 2, 3],\n[4.5, -5e-1, 6]]", "[]"].map(|list| list.as_bytes().to_vec()).to_vec()
}

fn xyzs() -> Vec<Vec<u8>> {
    let frames = [
        "2\nwater\nO 0.5 2 3.5\nH 4 5.5 -0.25\n",
        "1\nLattice=\"2 0 0 0 3 0 0 0 4\" Properties=species:S:1:pos:R:3:velo:R:3 Time=0.5\nO 1 2 3 4 5 6\n1\n\nO 1 2 3\n",
    ];
    let frames = frames.map(|frame| frame.as_bytes().to_vec());
    [tables(), frames.to_vec(), vec![build::raw(&tuples(4))]].concat()
}

pub fn vtus() -> Vec<Vec<u8>> {
    VtkXml::all().into_iter().map(|layout| layout.build(&tuples(2))).collect()
}

fn hdf5s() -> Vec<Vec<u8>> {
    // These seeds were written by the scripts in `tools/interop`, with other programs' libraries.
    let files: [(u8, &[u8]); 14] = [
        (0, include_bytes!("../../data/h5/columns.h5")),
        (1, include_bytes!("../../data/h5/groups.h5")),
        (1, include_bytes!("../../data/h5/h5md.h5")),
        (0, include_bytes!("../../data/h5/huge.h5")),
        (1, include_bytes!("../../data/h5/packed.h5")),
        (1, include_bytes!("../../data/h5/steps.h5part")),
        (0, include_bytes!("../../data/h5/table.h5")),
        (4, include_bytes!("../../data/simulations/gadget_005.1.hdf5")),
        (12, include_bytes!("../../data/simulations/gadget_005.hdf5")),
        (1, include_bytes!("../../data/simulations/steps.vtkhdf")),
        (0, include_bytes!("../../data/simulations/flags_poly.vtkhdf")),
        (0, include_bytes!("../../data/simulations/openpmd.h5")),
        (8, include_bytes!("../../data/simulations/pysph_40.hdf5")),
        (0, include_bytes!("../../data/simulations/swift_0003.hdf5")),
    ];
    files.map(|(choice, file)| [&[choice][..], file].concat()).to_vec()
}
