//! Tests of frames that a .pvd or a .vtm divides into several data sets: meshes are left out, a
//! condition applies to all data sets, and no name is dropped silently.

use std::fs;
use std::path::{Path, PathBuf};

use meniscus::internals::io::bytes::Unpacking;
use meniscus::internals::io::input::{open_joined, open_wanted};
use meniscus::internals::io::wanted::{WantedParticles, WantedPieces};
use meniscus::internals::io::{ParticleFile, ReadError, ReadFault, UnreadPart};
use meniscus::internals::particles::condition::Where;
use meniscus::internals::particles::selection::SelectionFault;
use meniscus::internals::particles::{AttributeInfo, Particles};
use tempfile::TempDir;

use crate::common::particle_files::{attribute, positions};

/// The walls of a simulation, as GPUSPH writes them.
const PLANES: &str = "<?xml version='1.0'?>
<VTKFile type='UnstructuredGrid'  version='0.1'  byte_order='LittleEndian'>
 <UnstructuredGrid>
  <Piece NumberOfPoints='5' NumberOfCells='2 '>
   <Points>
<DataArray type='Float64' NumberOfComponents='3'>
-1 -1 0
-1 1 0
1 1 0
1 -1 0
0 0 0
</DataArray>
   </Points>
   <Cells>
<DataArray type='Int32' Name='connectivity'>
 0 1 2 3
 0 1 2
</DataArray>
<DataArray type='Int32' Name='offsets'>
4
7
</DataArray>
<DataArray type='Int32' Name='types'>
7 7 
</DataArray>
   </Cells>
   <PointData />
  </Piece>
 </UnstructuredGrid>
</VTKFile>
";

/// A table of particles at (i, 0, 0) for each i. A second number is the particle's `Part type`.
fn table<const N: usize>(particles: &[[i32; N]]) -> String {
    let names = ["x,y,z", ",Part type"][..N].concat();
    let row = |particle: &[i32; N]| {
        let more: String = particle[1..].iter().map(|kind| format!(",{kind}")).collect();
        format!("{},0,0{more}\n", particle[0])
    };
    format!("{names}\n{}", particles.iter().map(row).collect::<String>())
}

/// A list of blocks.
fn multiblock(elements: &str) -> String {
    format!(
        "<VTKFile type='vtkMultiBlockDataSet'><vtkMultiBlockDataSet>\n{elements}\
        </vtkMultiBlockDataSet></VTKFile>\n"
    )
}

/// A folder with lists, and with the files that the list names.
struct Listed(TempDir);

impl Listed {
    /// Writes a .pvd list with one frame, and a .vtm list with the same blocks. Each of `sets`
    /// consists of the attributes of a data set's element, and the content of its file.
    fn new(sets: &[(&str, &str)]) -> Self {
        let listed = Self(TempDir::new().unwrap());
        let mut elements = String::new();
        for (attributes, content) in sets {
            let (_, file) = attributes.split_once("file='").unwrap();
            fs::write(listed.0.path().join(file.trim_end_matches('\'')), content).unwrap();
            elements += &format!("<DataSet timestep='0.5' {attributes}/>\n");
        }
        let list = format!("<VTKFile><Collection>\n{elements}</Collection></VTKFile>\n");
        fs::write(listed.path("list.pvd"), list).unwrap();
        fs::write(listed.path("list.vtm"), multiblock(&elements)).unwrap();
        listed
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn open_wanted(&self, wanted: WantedParticles) -> Result<ParticleFile, ReadError> {
        open_wanted(&self.path("list.pvd"), wanted, Unpacking::in_memory())
    }

    fn open(&self) -> Result<ParticleFile, ReadError> {
        self.open_wanted(WantedParticles::default())
    }

    fn open_where(&self, condition: &str) -> Result<ParticleFile, ReadError> {
        let conditions: [Where; 1] = [condition.parse().unwrap()];
        self.open_wanted(WantedParticles { conditions: &conditions, ..WantedParticles::default() })
    }
}

fn block(name: &str, holds: &str) -> UnreadPart {
    UnreadPart::Block { name: name.to_owned(), holds: holds.to_owned() }
}

fn names(names: &[&str]) -> UnreadPart {
    UnreadPart::Names(names.iter().map(|name| (*name).to_owned()).collect())
}

/// The first coordinate of each particle.
fn along(file: &ParticleFile) -> Vec<f64> {
    positions(file).iter().map(|position| position[0]).collect()
}

const TRIANGLE: &str = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\n\
    property float y\nproperty float z\nelement face 1\nproperty list uchar int vertex_indices\n\
    end_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";

#[test]
fn data_sets_without_particles_are_left_out_and_reported_by_name() {
    let listed = Listed::new(&[
        ("group='0' name='Planes' file='PLANES.vtu'", PLANES),
        ("group='1' name='Topography' file='DEM.vts'", "terrain"),
        ("group='2' file='ship.ply'", TRIANGLE),
        ("group='3' name='Particles' file='fluid.csv'", &table(&[[7, 0], [8, 1]])),
    ]);
    let file = listed.open().unwrap();
    assert_eq!(along(&file), [7.0, 8.0]);
    assert_eq!(attribute(&file, "Part type"), [0.0, 1.0]);
    assert_eq!((file.format, file.time), ("text table", Some(0.5)));
    let left_out = [
        block("Planes", "a mesh of 2 faces"),
        block("Topography", "data in the format .vts"),
        block("ship.ply", "a mesh of 1 faces"),
    ];
    assert_eq!(file.left_out, left_out);
}

/// Two points at x = 1 and x = 2, which a line connects, in each of VTK's formats.
const LINES: [(&str, &str); 4] = [
    (
        "lines.vtp",
        "<VTKFile type='PolyData'><PolyData><Piece NumberOfPoints='2' NumberOfLines='1'><Points>\
        <DataArray type='Float32' NumberOfComponents='3'>1 0 0 2 0 0</DataArray></Points></Piece>\
        </PolyData></VTKFile>",
    ),
    (
        "lines.vtu",
        "<VTKFile type='UnstructuredGrid'><UnstructuredGrid><Piece NumberOfPoints='2' \
        NumberOfCells='2'><Points><DataArray type='Float32' NumberOfComponents='3'>1 0 0 2 0 0\
        </DataArray></Points><Cells><DataArray type='UInt8' Name='types'>4 3</DataArray></Cells>\
        </Piece></UnstructuredGrid></VTKFile>",
    ),
    (
        "lines.vtk",
        "# vtk DataFile Version 3.0\nt\nASCII\nDATASET POLYDATA\nPOINTS 2 float\n1 0 0 2 0 0\n\
        LINES 1 3\n2 0 1\n",
    ),
    (
        "grid.vtk",
        "# vtk DataFile Version 3.0\nt\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 2 float\n\
        1 0 0 2 0 0\nCELLS 2 6\n2 0 1\n2 1 0\nCELL_TYPES 2\n4 3\n",
    ),
];

/// A data set without points.
const EMPTY: &str =
    "<VTKFile type='PolyData'><PolyData><Piece NumberOfPoints='0'/></PolyData></VTKFile>";

#[test]
fn lines_beside_particles_are_left_out_in_every_vtk_format() {
    let rows = table(&[[7, 0], [8, 1]]);
    let fluid = ("name='fluid' file='fluid.csv'", &*rows);
    for (file, content) in LINES {
        let gauges = format!("name='gauges' file='{file}'");
        let listed = Listed::new(&[(&*gauges, content), fluid]);
        for (opened, unselected) in
            [(listed.open().unwrap(), 0), (listed.open_where("Part type=0").unwrap(), 1)]
        {
            assert_eq!(along(&opened), [7.0, 8.0][..2 - unselected], "{file}");
            assert_eq!(opened.left_out, [block("gauges", "lines")], "{file}");
            assert_eq!(opened.unselected, unselected, "{file}");
        }
        // If a file also has vertex cells, its points are kept, even if lines connect them.
        let bonded = content
            .replace("NumberOfLines", "NumberOfVerts='2' NumberOfLines")
            .replace("4 3", "1 3")
            .replace("LINES", "VERTICES 2 4\n1 0 1 1\nLINES");
        assert_ne!(bonded, content);
        let listed = Listed::new(&[(&*gauges, &bonded), fluid]);
        assert_eq!(along(&listed.open().unwrap()), [1.0, 2.0, 7.0, 8.0], "{file}");
    }
}

#[test]
fn lines_are_particles_if_a_frame_has_nothing_else() {
    let [(vtp, one), (vtk, other)] = [LINES[0], LINES[2]];
    let [first, second] = [vtp, vtk].map(|file| format!("file='{file}'"));
    let alone = Listed::new(&[(&*first, one)]).open().unwrap();
    assert_eq!((along(&alone), alone.left_out), (vec![1.0, 2.0], vec![]));
    let planes = ("name='Planes' file='PLANES.vtu'", PLANES);
    let several = Listed::new(&[(&*first, one), planes, (&*second, other)]).open().unwrap();
    assert_eq!(along(&several), [1.0, 2.0, 1.0, 2.0]);
    assert_eq!(several.left_out, [block("Planes", "a mesh of 2 faces")]);
    let empty = ("name='fluid' file='empty.vtp'", EMPTY);
    let beside = Listed::new(&[(&*first, one), empty]).open().unwrap();
    assert_eq!(
        (along(&beside), beside.left_out),
        (vec![1.0, 2.0], vec![block("fluid", "no points")])
    );
}

#[test]
fn lines_in_pieces_are_left_out_of_a_frame_with_particles() {
    let pieces = "<VTKFile type='PPolyData'><PPolyData><Piece Source='empty.vtp'/>\
        <Piece Source='lines.vtp'/></PPolyData></VTKFile>";
    let listed = Listed::new(&[
        ("name='paths' file='paths.pvtp'", pieces),
        ("name='fluid' file='fluid.csv'", &table(&[[7]])),
    ]);
    fs::write(listed.path("empty.vtp"), EMPTY).unwrap();
    fs::write(listed.path("lines.vtp"), LINES[0].1).unwrap();
    let file = listed.open().unwrap();
    assert_eq!((along(&file), file.left_out), (vec![7.0], vec![block("paths", "lines")]));
}

#[test]
fn a_frame_of_meshes_alone_is_refused_and_a_damaged_file_is_not_left_out() {
    let planes = ("name='Planes' file='PLANES.vtu'", PLANES);
    let ship = ("name='ship' file='ship.ply'", TRIANGLE);
    let listed = Listed::new(&[planes, ship]);
    let error = listed.open().unwrap_err();
    let ReadFault::Unsupported(what) = &error.fault else { panic!("{error}") };
    assert!(what.contains("Planes") && what.contains("ship"), "{what}");
    assert_eq!(error.path, listed.path("list.pvd"));

    // If the only data set of a frame is a mesh, it is not left out: opening the frame fails.
    let error = Listed::new(&[planes]).open().unwrap_err();
    assert!(matches!(error.fault, ReadFault::Mesh { faces: 2 }), "{error}");

    let fluid = table(&[[7, 0]]);
    let listed = Listed::new(&[
        ("file='damaged.vtu'", &PLANES[..PLANES.len() - 20]),
        ("file='fluid.csv'", &fluid),
    ]);
    let error = listed.open().unwrap_err();
    assert!(matches!(error.fault, ReadFault::Malformed { .. }), "{error}");
    assert_eq!(error.path, listed.path("damaged.vtu"));
}

#[test]
fn a_mesh_in_pieces_is_left_out_of_a_frame() {
    let listed = Listed::new(&[
        (
            "name='walls' file='walls.pvtu'",
            "<VTKFile type='PUnstructuredGrid'>\
            <PUnstructuredGrid><Piece Source='piece.vtu'/></PUnstructuredGrid></VTKFile>",
        ),
        ("name='fluid' file='fluid.csv'", &table(&[[7]])),
    ]);
    fs::write(listed.path("piece.vtu"), PLANES).unwrap();
    let file = listed.open().unwrap();
    assert_eq!((along(&file), file.left_out), (vec![7.0], vec![block("walls", "a mesh")]));
    // A missing piece is an error.
    fs::remove_file(listed.path("piece.vtu")).unwrap();
    let error = listed.open().unwrap_err();
    assert_eq!(error.path, listed.path("piece.vtu"));
}

#[test]
fn no_particle_of_a_data_set_without_the_attribute_meets_a_condition() {
    let listed = Listed::new(&[
        ("name='Planes' file='PLANES.vtu'", PLANES),
        ("name='WaveGages' file='gauges.csv'", &table(&[[1], [2], [3]])),
        ("name='Particles' file='fluid.csv'", &table(&[[7, 0], [8, 1], [9, 0]])),
    ]);
    let file = listed.open_where("Part type=0").unwrap();
    assert_eq!(along(&file), [7.0, 9.0]);
    assert_eq!(attribute(&file, "Part type"), [0.0, 0.0]);
    assert_eq!((file.unselected, file.left_out), (4, vec![block("Planes", "a mesh of 2 faces")]));
    // Particles without the attribute never meet a condition on it, even if the operator is `!=`.
    assert_eq!(along(&listed.open_where("Part type!=0").unwrap()), [8.0]);
    // If no particle meets the condition, the fault counts only the particles that have the
    // attribute.
    let none = listed.open_where("Part type=7").unwrap();
    assert_eq!((none.particles.len(), none.unselected), (0, 6));
    assert_eq!(none.particles.attributes(), [AttributeInfo::new("Part type", 1)]);
    assert!(matches!(none.none_selected, Some(SelectionFault::None { of: 3, .. })));
}

#[test]
fn an_attribute_that_every_data_set_lacks_is_an_error() {
    let listed = Listed::new(&[
        ("name='Planes' file='PLANES.vtu'", PLANES),
        ("name='WaveGages' file='gauges.csv'", &table(&[[1], [2]])),
        ("name='Particles' file='fluid.csv'", &table(&[[7, 0], [8, 1], [9, 0]])),
    ]);
    let error = listed.open_where("mk=0").unwrap_err();
    // The error lists the attributes of the data set with the most particles.
    assert_eq!(error.path, listed.path("fluid.csv"));
    let ReadFault::Selection(SelectionFault::NoAttribute { name, known }) = &error.fault else {
        panic!("{error}")
    };
    assert_eq!((&**name, &known[..]), ("mk", &["Part type".to_owned()][..]));
}

#[test]
fn the_names_of_joined_data_sets_are_reported_unless_only_one_remains() {
    let [fluid, wall] = [table(&[[7, 0], [8, 0]]), table(&[[1, 1]])];
    let listed = Listed::new(&[
        ("part='0' name='fluid' file='a.csv'", &fluid),
        ("part='1' name='boundary' file='b.csv'", &wall),
        ("part='2' name='fluid' file='c.csv'", &table(&[[9, 0]])),
    ]);
    let file = listed.open().unwrap();
    assert_eq!(along(&file), [7.0, 8.0, 1.0, 9.0]);
    assert_eq!(file.left_out, [names(&["fluid", "boundary"])]);
    assert_eq!(listed.open_where("Part type=0").unwrap().left_out, []);
    let unnamed = Listed::new(&[("file='a.csv'", &fluid), ("name='wall' file='b.csv'", &wall)]);
    assert_eq!(unnamed.open().unwrap().left_out, []);
}

#[test]
fn attributes_that_a_data_set_with_particles_lacks_are_left_out() {
    let listed = Listed::new(&[
        ("name='WaveGages' file='gauges.csv'", &table(&[[1]])),
        ("name='Particles' file='fluid.csv'", &table(&[[7, 0]])),
    ]);
    let file = listed.open().unwrap();
    assert_eq!(along(&file), [1.0, 7.0]);
    let lacking = UnreadPart::Attribute(AttributeInfo::new("Part type", 1));
    assert_eq!(file.left_out, [names(&["WaveGages", "Particles"]), lacking]);
}

#[test]
fn a_data_set_without_points_is_reported_if_it_has_a_name() {
    let listed = Listed::new(&[
        ("name='foam' file='foam.vtp'", EMPTY),
        ("file='rank_1.vtp'", EMPTY),
        ("name='fluid' file='fluid.csv'", &table(&[[7, 0]])),
    ]);
    let file = listed.open().unwrap();
    assert_eq!(along(&file), [7.0]);
    assert_eq!(attribute(&file, "Part type"), [0.0]);
    assert_eq!(file.left_out, [block("foam", "no points")]);
    // A data set is not reported as having no points if a condition has removed its particles.
    let listed = Listed::new(&[
        ("name='foam' file='foam.csv'", &table(&[[1, 2]])),
        ("name='fluid' file='fluid.csv'", &table(&[[7, 0]])),
    ]);
    assert_eq!(listed.open_where("Part type=0").unwrap().left_out, []);
    // A frame without any particles is not an error.
    let listed = Listed::new(&[("file='a.vtp'", EMPTY), ("file='b.vtp'", EMPTY)]);
    assert!(listed.open().unwrap().particles.is_empty());
}

#[test]
fn data_sets_that_are_left_out_keep_their_numbers_as_pieces() {
    let listed = Listed::new(&[
        ("name='Planes' file='PLANES.vtu'", PLANES),
        ("file='a.csv'", &table(&[[7, 0]])),
        ("file='b.csv'", &table(&[[8, 0], [9, 0]])),
    ]);
    let chunks = listed.open().unwrap().particles.chunks(10);
    let of_pieces: Vec<_> = chunks.iter().map(|chunk| (chunk.piece, chunk.count)).collect();
    assert_eq!(of_pieces, [(1, 1), (2, 2)]);
    // Opening a part of a frame opens only the part's pieces, and ignores the damaged piece.
    fs::write(listed.path("PLANES.vtu"), "damaged").unwrap();
    let wanted =
        WantedParticles { pieces: WantedPieces::Numbered(&[2]), ..WantedParticles::default() };
    let file = listed.open_wanted(wanted).unwrap();
    assert_eq!((along(&file), file.format), (vec![8.0, 9.0], "text table"));
    listed.open().unwrap_err();
}

#[test]
fn files_that_are_joined_by_name_must_not_be_meshes() {
    let folder = TempDir::new().unwrap();
    let [planes, fluid] = ["PLANES.vtu", "fluid.csv"].map(|name| folder.path().join(name));
    fs::write(&planes, PLANES).unwrap();
    fs::write(&fluid, table(&[[7, 0]])).unwrap();
    let paths: [&Path; 2] = [&planes, &fluid];
    let joined = open_joined(&paths, WantedParticles::default(), Unpacking::in_memory());
    assert!(matches!(joined.unwrap_err().fault, ReadFault::Mesh { faces: 2 }));
}

#[test]
fn a_multiblock_file_is_read_like_a_list_of_the_same_data_sets() {
    let listed = Listed::new(&[
        ("name='Planes' file='PLANES.vtu'", PLANES),
        ("name='gauges' file='lines.vtp'", LINES[0].1),
        ("name='fluid' file='a.csv'", &table(&[[7], [8]])),
        ("name='boundary' file='b.csv'", &table(&[[1, 1], [2, 0]])),
    ]);
    let left_out = [
        block("Planes", "a mesh of 2 faces"),
        block("gauges", "lines"),
        names(&["fluid", "boundary"]),
        UnreadPart::Attribute(AttributeInfo::new("Part type", 1)),
    ];
    fs::write(listed.path("outer.vtm"), multiblock("<DataSet file='list.vtm'/>")).unwrap();
    let frame = "<VTKFile><Collection><DataSet file='list.vtm'/><DataSet file='empty.vtp'/>\
        </Collection></VTKFile>";
    fs::write(listed.path("outer.pvd"), frame).unwrap();
    fs::write(listed.path("empty.vtp"), EMPTY).unwrap();
    for name in ["list.pvd", "list.vtm", "outer.vtm", "outer.pvd"] {
        let open = |condition: Option<&str>| {
            let conditions: Vec<Where> = condition.iter().map(|c| c.parse().unwrap()).collect();
            let wanted = WantedParticles { conditions: &conditions, ..WantedParticles::default() };
            open_wanted(&listed.path(name), wanted, Unpacking::in_memory())
        };
        let file = open(None).unwrap();
        assert_eq!((along(&file), &file.left_out[..]), (vec![7.0, 8.0, 1.0, 2.0], &left_out[..]));
        let selected = open(Some("Part type=1")).unwrap();
        assert_eq!((along(&selected), selected.unselected), (vec![1.0], 3), "{name}");
        assert_eq!(selected.left_out, left_out[..2], "{name}");
        let fault = open(Some("mk=1")).unwrap_err().fault;
        let is_missing = matches!(&fault, ReadFault::Selection(SelectionFault::NoAttribute { .. }));
        assert!(is_missing, "{name}: {fault}");
    }
}

#[test]
fn a_block_without_a_name_has_the_name_of_the_element_or_list_around_it() {
    let listed = Listed::new(&[
        ("file='a.csv'", &table(&[[7]])),
        ("file='b.csv'", &table(&[[8]])),
        ("file='c.csv'", &table(&[[9]])),
    ]);
    fs::write(listed.path("list.vtm"), multiblock("<DataSet file='c.csv'/>")).unwrap();
    let elements = "<Block name='fluid'><Piece name='water'><DataSet file='a.csv'/></Piece>\
        <DataSet file='b.csv'/></Block><DataSet name='walls' file='list.vtm'/>";
    fs::write(listed.path("outer.vtm"), multiblock(elements)).unwrap();
    let path = listed.path("outer.vtm");
    let file = open_wanted(&path, WantedParticles::default(), Unpacking::in_memory()).unwrap();
    assert_eq!(along(&file), [7.0, 8.0, 9.0]);
    assert_eq!(file.left_out, [names(&["water", "fluid", "walls"])]);
}
