//! Tests of VTK files that list pieces: each particle is read once, a mesh is complete, and an
//! error names the piece.

use std::fs;
use std::path::{Path, PathBuf};

use meniscus::internals::io::bytes::Unpacking;
use meniscus::internals::io::frame_files::listed_pieces;
use meniscus::internals::io::input::{holds_mesh, open_particles};
use meniscus::internals::io::output::{MeshOutput, read_mesh};
use meniscus::internals::io::whole::Replace;
use meniscus::internals::io::{
    CoordinateWidth, ParticleFile, ReadError, ReadFault, UnreadPart, WriteFault,
};
use meniscus::internals::particles::{AttributeInfo, Particles};
use tempfile::TempDir;

use crate::build::{VtkXml, tuples};
use crate::common::files::{self, tree};
use crate::common::particle_files::{attribute, positions};
use crate::common::program::command;
use crate::common::shapes::{torus, with_attributes};

fn data(name: &str) -> PathBuf {
    files::data("simulations").join(name)
}

fn open(path: &Path) -> Result<ParticleFile, ReadError> {
    open_particles(path, Unpacking::in_memory())
}

/// A folder with a list and two pieces, which have two and four points.
struct Set(TempDir);

impl Set {
    fn new() -> Self {
        let set = Self(TempDir::new().unwrap());
        fs::create_dir(set.path("p")).unwrap();
        set.write("a.pvtu", &list(&["p/0.vtu", "p/1.vtu"]));
        set.write("p/0.vtu", &piece("Float64", &[0, 1], &["id"], &[]));
        set.write("p/1.vtu", &piece("Float64", &[2, 3, 4, 5], &["id"], &[]));
        set
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn write(&self, name: &str, text: &str) {
        fs::write(self.path(name), text).unwrap();
    }

    fn open(&self) -> Result<ParticleFile, ReadError> {
        open(&self.path("a.pvtu"))
    }
}

fn list(sources: &[&str]) -> String {
    let pieces: String =
        sources.iter().map(|source| format!("<Piece Source=\"{source}\"/>\n")).collect();
    format!(
        "<VTKFile type=\"PUnstructuredGrid\"><PUnstructuredGrid GhostLevel=\"1\">\n{pieces}</PUnstructuredGrid></VTKFile>\n"
    )
}

/// A piece with a point at (i, 2 i, 3 i) + 0.1 for each i in `points`. All attributes of the point
/// have the value i. The points in `ghosts` are flagged as ghosts.
fn piece(kind: &str, points: &[usize], attributes: &[&str], ghosts: &[usize]) -> String {
    let numbers = |values: &mut dyn Iterator<Item = String>| values.collect::<Vec<_>>().join(" ");
    let where_ = numbers(
        &mut points.iter().flat_map(|&i| [1, 2, 3].map(|k| format!("{}", (k * i) as f64 + 0.1))),
    );
    let array = |kind: &str, name: &str, text: String| {
        format!("<DataArray type=\"{kind}\" Name=\"{name}\" format=\"ascii\">{text}</DataArray>\n")
    };
    let mut data: String = attributes
        .iter()
        .map(|name| array("Float32", name, numbers(&mut points.iter().map(|i| i.to_string()))))
        .collect();
    if !ghosts.is_empty() {
        let flags = numbers(&mut points.iter().map(|i| u8::from(ghosts.contains(i)).to_string()));
        data += &array("UInt8", "vtkGhostType", flags);
    }
    format!(
        "<VTKFile type=\"UnstructuredGrid\"><UnstructuredGrid><Piece NumberOfPoints=\"{}\">\n\
         <PointData>{data}</PointData>\n\
         <Points><DataArray type=\"{kind}\" NumberOfComponents=\"3\" format=\"ascii\">{where_}</DataArray></Points>\n\
         </Piece></UnstructuredGrid></VTKFile>\n",
        points.len(),
    )
}

fn at(i: usize) -> [f64; 3] {
    [1, 2, 3].map(|k| (k * i) as f64 + 0.1)
}

#[test]
fn pieces_written_by_vtk_are_joined_without_ghosts() {
    let points = positions(&open(&data("points.csv")).unwrap());
    for name in ["poly_0007.pvtp", "grid_0007.pvtu"] {
        let file = open(&data(name)).unwrap();
        assert_eq!(positions(&file), points, "{name}");
        assert_eq!((file.ghosts, file.time), (8, Some(0.75)), "{name}");
        let names: Vec<_> =
            file.particles.attributes().iter().map(|a| (&*a.name, a.components)).collect();
        assert_eq!(names, [("velocity", 3), ("id", 1)], "{name}");
        assert_eq!(attribute(&file, "id"), (0..24).map(|i| i as f32).collect::<Vec<_>>(), "{name}");
        assert!(!holds_mesh(&data(name)).unwrap(), "{name}");
        // Every range of particles must be right, even across ghosts and pieces.
        for first in 0..=points.len() {
            for count in 0..=points.len() - first {
                let mut part = vec![[0.0; 3]; count];
                file.particles.positions(first, &mut part);
                assert_eq!(part, points[first..first + count], "{name} {first} {count}");
            }
        }
    }
}

#[test]
fn ghosts_are_omitted_even_if_a_piece_contains_only_ghosts() {
    let set = Set::new();
    for (flagged, left) in [
        ([vec![1], vec![2]], vec![0, 3, 4, 5]),
        ([vec![0, 1], vec![3, 5]], vec![2, 4]),
        ([vec![0], vec![2, 3, 4, 5]], vec![1]),
        ([vec![0, 1], vec![2, 3, 4, 5]], vec![]),
    ] {
        set.write("p/0.vtu", &piece("Float64", &[0, 1], &["id"], &flagged[0]));
        set.write("p/1.vtu", &piece("Float64", &[2, 3, 4, 5], &["id"], &flagged[1]));
        let file = set.open().unwrap();
        assert_eq!(file.ghosts, 6 - left.len());
        assert_eq!(positions(&file), left.iter().map(|&i| at(i)).collect::<Vec<_>>());
        assert_eq!(attribute(&file, "id"), left.iter().map(|&i| i as f32).collect::<Vec<_>>());
    }
}

#[test]
fn pieces_may_be_empty_or_differ_in_precision_and_attribute_order() {
    let set = Set::new();
    set.write("a.pvtu", &list(&["p/none.vtu", "p/0.vtu", "p/1.vtu"]));
    set.write("p/none.vtu", &piece("Float32", &[], &[], &[]));
    set.write(
        "p/0.vtu",
        &piece("Float32", &[0, 1], &["id", "mass"], &[]).replace("Float64", "Float32"),
    );
    set.write("p/1.vtu", &piece("Float64", &[2, 3, 4, 5], &["mass", "id"], &[]));
    let file = set.open().unwrap();
    assert_eq!(positions(&file), (0..6).map(at).collect::<Vec<_>>());
    assert_eq!(attribute(&file, "mass"), [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]);
}

#[test]
fn attributes_missing_in_a_piece_are_omitted_and_reported_by_name() {
    let set = Set::new();
    set.write("p/0.vtu", &piece("Float64", &[0, 1], &["id", "mass"], &[]));
    set.write("p/1.vtu", &piece("Float64", &[2, 3, 4, 5], &["T", "id"], &[3]));
    // Write both pieces into one file.
    let whole = |name: &str| fs::read_to_string(set.path(name)).unwrap();
    let (first, second) = (whole("p/0.vtu"), whole("p/1.vtu"));
    let more = &second[second.find("<Piece").unwrap()..second.find("</Unstr").unwrap()];
    set.write("one.vtu", &first.replace("</Piece>", &format!("</Piece>{more}")));
    for name in ["a.pvtu", "one.vtu"] {
        let file = open(&set.path(name)).unwrap();
        assert_eq!(positions(&file), [0, 1, 2, 4, 5].map(at), "{name}");
        assert_eq!(attribute(&file, "id"), [0.0, 1.0, 2.0, 4.0, 5.0], "{name}");
        assert_eq!((file.particles.attributes().len(), file.ghosts), (1, 1), "{name}");
        let info = |name: &str| AttributeInfo::new(name, 1);
        assert_eq!(file.left_out, ["mass", "T"].map(info).map(UnreadPart::Attribute), "{name}");
    }
}

#[test]
fn several_pieces_in_one_file_are_joined_for_all_encodings_and_types() {
    let set = Set::new();
    let points: Vec<[f64; 3]> = tuples(5);
    for layout in VtkXml::all() {
        let one = String::from_utf8_lossy(&layout.build(&points)).into_owned();
        // Two pieces of a file may use the same appended data.
        let bytes = layout.build(&points);
        let (start, end) = (one.find("<Piece").unwrap(), one.find("</Unstr").unwrap());
        let text = piece("Float64", &[0, 1], &["id"], &[]);
        let text = &text[text.find("<Piece").unwrap()..text.find("</Unstr").unwrap()];
        let text = text.replace("<PointData>", "<PointData><DataArray type=\"Int8\" Name=\"velocity\" NumberOfComponents=\"3\" format=\"ascii\">1 2 3 4 5 6</DataArray>");
        let joined = [&bytes[..end], &bytes[start..end], text.as_bytes(), &bytes[end..]].concat();
        fs::write(set.path("many.vtu"), joined).unwrap();
        let file = open(&set.path("many.vtu")).unwrap();
        let expected = [points.clone(), points.clone(), [0, 1].map(at).to_vec()].concat();
        assert_eq!(positions(&file), expected, "{layout:?}");
        assert_eq!((file.time, file.left_out.len()), (Some(1.5), 0), "{layout:?}");
        let ids = [0, 1, 2, 3, 4, 0, 1, 2, 3, 4, 0, 1].map(|id| id as f32);
        assert_eq!(attribute(&file, "id"), ids, "{layout:?}");
        assert_eq!(attribute(&file, "velocity")[30..], [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
        let mut part = [[0.0; 3]; 4];
        file.particles.positions(4, &mut part);
        assert_eq!(part, expected[4..8], "{layout:?}");
    }
}

#[test]
fn a_multiblock_file_gives_its_particles_and_names_skipped_blocks() {
    let set = Set::new();
    let list = |blocks: &str| {
        format!(
            "<VTKFile type=\"vtkMultiBlockDataSet\"><vtkMultiBlockDataSet>{blocks}</vtkMultiBlockDataSet></VTKFile>"
        )
    };
    let cells = piece("Float64", &[0, 1, 2, 3], &["id"], &[]);
    let cells = cells.replace("NumberOfPoints", "NumberOfCells=\"1\" NumberOfPoints").replace(
        "<Points>",
        "<Cells><DataArray type=\"UInt8\" Name=\"types\" format=\"ascii\">10</DataArray></Cells><Points>",
    );
    set.write("p/solid.vtu", &cells);
    set.write("inner.vtm", &list("<DataSet index=\"0\" file=\"p/1.vtu\"/>"));
    let solid = "<DataSet name=\"solid\" file=\"p/solid.vtu\"/>";
    set.write(
        "a.vtm",
        &list(&format!(
            "<DataSet file=\"p/0.vtu\"/><DataSet index=\"1\"/><Block>{solid}<DataSet file=\"inner.vtm\"/></Block><DataSet file=\"p/i.vti\"/>"
        )),
    );
    let file = open(&set.path("a.vtm")).unwrap();
    assert_eq!(positions(&file), (0..6).map(at).collect::<Vec<_>>());
    let named = |left_out: &UnreadPart| match left_out {
        UnreadPart::Block { name, .. } => name.clone(),
        UnreadPart::Attribute(info) => info.name.clone(),
        _ => panic!("{left_out}"),
    };
    assert_eq!(file.left_out.iter().map(named).collect::<Vec<_>>(), ["solid", "i.vti"]);
    set.write("a.vtm", &list(solid));
    let fault = open(&set.path("a.vtm")).unwrap_err().fault;
    assert!(matches!(&fault, ReadFault::Unsupported(what) if what.contains("solid")), "{fault}");
    // Lists that contain each other are refused.
    set.write("a.vtm", &list("<DataSet file=\"b.vtm\"/>"));
    set.write("b.vtm", &list("<DataSet file=\"a.vtm\"/>"));
    let fault = open(&set.path("a.vtm")).unwrap_err().fault;
    assert!(matches!(fault, ReadFault::Malformed { .. }), "{fault}");
}

#[test]
fn piece_names_are_resolved_in_windows_and_url_spelling() {
    let set = Set::new();
    fs::create_dir(set.path("sub dir")).unwrap();
    for name in ["sub dir/p 0.vtu", "sub dir/50%20.vtu"] {
        set.write(name, &piece("Float64", &[2, 3], &[], &[]));
    }
    let absolute = set.path("p/0.vtu").display().to_string();
    for (name, path) in [
        ("p\\0.vtu", "p/0.vtu"),
        (".\\p\\0.vtu", "p/0.vtu"),
        ("./p/0.vtu", "p/0.vtu"),
        ("p/../p/./0.vtu", "p/0.vtu"),
        ("sub%20dir/p%200.vtu", "sub dir/p 0.vtu"),
        ("sub%20dir\\p 0.vtu", "sub dir/p 0.vtu"),
        ("sub dir/50%20.vtu", "sub dir/50%20.vtu"),
        (&absolute, "p/0.vtu"),
    ] {
        set.write("a.pvtu", &list(&[name]));
        assert_eq!(listed_pieces(&set.path("a.pvtu")).unwrap(), [set.path(path)], "{name}");
        assert_eq!(set.open().unwrap().particles.len(), 2, "{name}");
    }
}

#[test]
fn an_error_in_a_piece_names_the_file_of_the_piece() {
    for (name, text, message) in [
        ("p/0.vtu", "<VTKFile".to_owned(), "ends without </VTKFile>"),
        (
            "p/1.vtu",
            piece("Float64", &[2, 3], &["id"], &[])
                .replace("NumberOfPoints=\"2\"", "NumberOfPoints=\"9\""),
            "9 points",
        ),
        ("a.pvtu", list(&["p/0.vtu", "p/0.vtu"]), "p/0.vtu twice"),
        ("a.pvtu", list(&[]), "names no pieces"),
        ("a.pvtu", list(&[""]), "has no Source"),
        ("a.pvtu", list(&["p/0.vtu"]).replace("PUnstructuredGrid", "PImageData"), "PImageData"),
    ] {
        let set = Set::new();
        set.write(name, &text);
        let error = set.open().expect_err(message);
        assert!(error.path == set.path(name) && error.to_string().contains(message), "{error}");
    }
    let set = Set::new();
    fs::remove_file(set.path("p/1.vtu")).unwrap();
    let error = set.open().unwrap_err();
    assert!(
        error.path == set.path("p/1.vtu") && matches!(error.fault, ReadFault::Io(_)),
        "{error}"
    );
}

#[test]
fn truncated_lists_and_pieces_are_refused_and_flipped_bytes_never_panic() {
    for name in ["a.pvtu", "p/1.vtu"] {
        let set = Set::new();
        let whole = fs::read(set.path(name)).unwrap();
        for end in 0..whole.trim_ascii_end().len() {
            fs::write(set.path(name), &whole[..end]).unwrap();
            let error = set.open().expect_err("cut");
            assert_eq!(error.path, set.path(name), "cut at {end}");
        }
        for at in 0..whole.len() {
            for flip in [0x01, 0x80, 0xff] {
                let mut bytes = whole.clone();
                bytes[at] ^= flip;
                fs::write(set.path(name), bytes).unwrap();
                let _ = (
                    set.open(),
                    listed_pieces(&set.path("a.pvtu")),
                    holds_mesh(&set.path("a.pvtu")),
                );
            }
        }
    }
}

#[test]
fn pieces_in_a_folder_of_lists_are_not_taken_for_frames() {
    let set = Set::new();
    for frame in [1, 2] {
        let names = [0, 1].map(|k| format!("a_{frame}_{k}.vtu"));
        set.write(&names[0], &piece("Float64", &[0, 1], &["id"], &[]));
        set.write(&names[1], &piece("Float64", &[2, 3, 4, 5], &["id"], &[]));
        set.write(&format!("a_{frame}.pvtu"), &list(&[&names[0], &names[1]]));
    }
    for inputs in [".", "*.*vtu"] {
        let arguments = ["reconstruct", inputs, "-o", "m/", "--spacing", "1", "--overwrite"];
        let output = command(&set.path(""), &arguments).output().unwrap();
        let messages = String::from_utf8_lossy(&output.stderr).into_owned();
        // In the folder, the list is not a frame, because its name has no number.
        let expected = if inputs == "." { Some(0) } else { output.status.code() };
        assert_eq!(output.status.code(), expected, "{messages}");
        if inputs == "." {
            let list: serde_json::Value =
                serde_json::from_slice(&fs::read(set.path("m/a.ply.json")).unwrap()).unwrap();
            let frames: Vec<_> = list["frames"]
                .as_array()
                .unwrap()
                .iter()
                .map(|f| f["particles"].as_u64())
                .collect();
            assert_eq!(frames, [Some(6), Some(6)]);
        }
    }
}

#[test]
fn a_pvtp_mesh_is_a_list_and_a_folder_that_read_back_unchanged() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("torus.pvtp");
    let mesh = with_attributes(torus(20, 10));
    let write = |replace| {
        let output = MeshOutput::prepare(&path, replace)?;
        output.write(&mesh, CoordinateWidth::F64)
    };
    write(Replace::Refuse).unwrap();
    let files: Vec<String> = tree(folder.path()).into_keys().collect();
    assert_eq!(files, ["torus.pvtp", "torus/torus_0.vtp"]);
    assert_eq!(read_mesh(&path).unwrap(), mesh);
    assert!(holds_mesh(&path).unwrap());

    // The list and its folder are replaced only with `Replace::Allow`, and never if the folder
    // contains other files.
    let exists = |fault: &WriteFault| matches!(fault, WriteFault::Exists);
    assert!(exists(&write(Replace::Refuse).unwrap_err().fault));
    fs::remove_file(&path).unwrap();
    assert!(exists(&write(Replace::Refuse).unwrap_err().fault));
    write(Replace::Allow).unwrap();
    let before = tree(folder.path());
    write(Replace::Allow).unwrap();
    assert_eq!(tree(folder.path()), before);
    fs::write(folder.path().join("torus/notes.txt"), "mine").unwrap();
    let fault = write(Replace::Allow).unwrap_err().fault;
    assert!(
        matches!(&fault, WriteFault::Unsupported(what) if what.contains("other files")),
        "{fault}"
    );
    assert_eq!(tree(folder.path()).len(), before.len() + 1);
    // A missing piece is reported.
    fs::remove_file(folder.path().join("torus/torus_0.vtp")).unwrap();
    assert!(read_mesh(&path).unwrap_err().path.ends_with("torus_0.vtp"));
}

/// A piece like that of [`piece`], with a vertex for each point in `order`. The array `name`
/// contains the flags of the vertices.
fn with_cells(polydata: bool, order: &[usize], name: &str, flags: &[u8]) -> String {
    let numbers = |values: &mut dyn Iterator<Item = usize>| {
        values.map(|value| value.to_string()).collect::<Vec<_>>().join(" ")
    };
    let array = |name: &str, text: String| {
        format!("<DataArray type=\"Int64\" Name=\"{name}\" format=\"ascii\">{text}</DataArray>")
    };
    let cells = array("connectivity", numbers(&mut order.iter().copied()))
        + &array("offsets", numbers(&mut (1..=order.len())));
    let (section, count, types) = match polydata {
        true => ("Verts", "NumberOfVerts", String::new()),
        false => ("Cells", "NumberOfCells", array("types", numbers(&mut order.iter().map(|_| 1)))),
    };
    let data = array(name, numbers(&mut flags.iter().map(|&flag| flag.into())));
    let text = piece("Float64", &[0, 1, 2, 3, 4, 5], &["id"], &[])
        .replace("<Piece ", &format!("<Piece {count}=\"{}\" ", order.len()))
        .replace(
            "<Points>",
            &format!("<CellData>{data}</CellData><{section}>{cells}{types}</{section}><Points>"),
        );
    if polydata { text.replace("UnstructuredGrid", "PolyData") } else { text }
}

fn points_left(polydata: bool, text: &str) -> Result<Vec<usize>, ReadError> {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join(if polydata { "a.vtp" } else { "a.vtu" });
    fs::write(&path, text).unwrap();
    let file = open(&path)?;
    let ids: Vec<usize> = attribute(&file, "id").iter().map(|&id| id as usize).collect();
    assert_eq!(positions(&file), ids.iter().map(|&i| at(i)).collect::<Vec<_>>());
    assert_eq!(file.ghosts, 6 - ids.len());
    Ok(ids)
}

#[test]
fn points_whose_vertices_are_all_ghosts_are_omitted() {
    let order = [5, 4, 3, 2, 1, 0];
    for polydata in [true, false] {
        for (name, flags, left) in [
            ("vtkGhostType", [1, 0, 0, 8, 0, 32], &[1, 3, 4][..]),
            // The flags for high connectivity, low connectivity and exterior do not mean a ghost.
            ("vtkGhostType", [2, 4, 16, 0, 0, 0], &[0, 1, 2, 3, 4, 5]),
            ("vtkGhostLevels", [2, 1, 0, 0, 0, 0], &[0, 1, 2, 3]),
            ("vtkGhostType", [1; 6], &[]),
            ("other", [1; 6], &[0, 1, 2, 3, 4, 5]),
        ] {
            let found = points_left(polydata, &with_cells(polydata, &order, name, &flags)).unwrap();
            assert_eq!(found, left, "{name} {flags:?}");
        }
        // A point with a flagged and an unflagged vertex is not a ghost, and neither is a point
        // without vertices.
        let text = with_cells(polydata, &[0, 0, 1, 2, 2], "vtkGhostType", &[1, 0, 1, 1, 1]);
        assert_eq!(points_left(polydata, &text).unwrap(), [0, 3, 4, 5]);
        // Flags of a cell with several points do not apply to its points.
        let text = with_cells(polydata, &order, "vtkGhostType", &[1; 6]);
        let line = text.replace(">1 2 3 4 5 6<", ">1 2 3 4 5 7<");
        assert_eq!(points_left(polydata, &line).unwrap().len(), 6);
    }
    let text = with_cells(false, &order, "vtkGhostType", &[1; 6]);
    assert_eq!(
        points_left(
            false,
            &text.replace(">1 1 1 1 1 1</DataArray></Cells>", ">1 1 3 1 1 1</DataArray></Cells>")
        )
        .unwrap()
        .len(),
        6
    );
    let text = with_cells(true, &order, "vtkGhostType", &[1; 6]);
    assert_eq!(
        points_left(true, &text.replace("<Piece ", "<Piece NumberOfLines=\"1\" ")).unwrap().len(),
        6
    );
}

#[test]
fn cell_data_of_one_vertex_per_point_in_order_are_attributes() {
    let folder = TempDir::new().unwrap();
    let (order, masses) = ([0, 1, 2, 3, 4, 5], [7, 5, 3, 2, 1, 0]);
    for polydata in [true, false] {
        let read = |text: &str| {
            let path = folder.path().join(if polydata { "a.vtp" } else { "a.vtu" });
            fs::write(&path, text).unwrap();
            open(&path).unwrap()
        };
        let text = with_cells(polydata, &order, "mass", &masses);
        let file = read(&text);
        assert_eq!(attribute(&file, "mass"), [7.0, 5.0, 3.0, 2.0, 1.0, 0.0]);
        assert_eq!(file.left_out, []);
        let unordered = with_cells(polydata, &[1, 0, 2, 3, 4, 5], "mass", &masses);
        let fewer = with_cells(polydata, &order[1..], "mass", &masses[1..]);
        let several = text.replace(">1 2 3 4 5 6<", ">1 2 3 4 5 7<");
        for other in [unordered, fewer, several] {
            let file = read(&other);
            assert_eq!(file.particles.attributes().len(), 1, "{other}");
            assert_eq!(file.left_out, [UnreadPart::CellData("mass".into())]);
        }
    }
}

#[test]
fn cell_flags_and_point_flags_of_all_pieces_are_combined() {
    let set = Set::new();
    let order = [0, 1, 2, 3, 4, 5];
    let both = with_cells(false, &order, "vtkGhostType", &[1, 0, 0, 0, 0, 1]);
    let flags = "<PointData><DataArray type=\"UInt8\" Name=\"vtkGhostType\" format=\"ascii\">0 1 0 0 0 1</DataArray>";
    set.write("p/0.vtu", &both.replace("<PointData>", flags));
    set.write(
        "p/1.vtu",
        &with_cells(false, &order, "vtkGhostType", &[0, 0, 1, 0, 0, 0])
            .replace("<PointData>", &flags.replace('1', "0")),
    );
    let file = set.open().unwrap();
    assert_eq!(attribute(&file, "id"), [2.0, 3.0, 4.0, 0.0, 1.0, 3.0, 4.0, 5.0]);
    assert_eq!(file.ghosts, 4);
}

#[test]
fn inconsistent_cells_are_refused_and_damage_never_panics() {
    for polydata in [true, false] {
        let whole = with_cells(polydata, &[5, 4, 3, 2, 1, 0], "vtkGhostType", &[1, 0, 0, 1, 0, 0]);
        let name = if polydata { "NumberOfVerts" } else { "NumberOfCells" };
        for (from, to, message) in [
            (">5 4 3 2 1 0<", ">5 4 3 2 1 6<", "refers to point 6, but there are 6 cells"),
            (">5 4 3 2 1 0<", ">5 4 3 2 1 -1<", "refers to point -1, but there are 6 cells"),
            (">5 4 3 2 1 0<", ">5 4 3 2 1<", "6 cells refer to 5 points"),
            (">1 0 0 1 0 0<", ">1 0 0 1 0<", "for each of 6 cells"),
            (
                &format!("{name}=\"6\""),
                &format!("{name}=\"99999999999999\""),
                "99999999999999 cells are announced",
            ),
            ("NumberOfPoints=\"6\"", "NumberOfPoints=\"99999999999999\"", "99999999999999 points"),
        ] {
            let text = whole.replace(from, to);
            assert_ne!(text, whole);
            let error = points_left(polydata, &text).expect_err(message);
            assert!(error.to_string().contains(message), "{error}");
        }
        let folder = TempDir::new().unwrap();
        let path = folder.path().join(if polydata { "a.vtp" } else { "a.vtu" });
        for at in 0..whole.len() {
            let mut bytes = whole.clone().into_bytes();
            bytes[at] ^= 1 << (at % 8);
            fs::write(&path, bytes).unwrap();
            let _ = open(&path);
        }
    }
}
