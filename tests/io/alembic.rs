//! Tests of Alembic archives: each array, its digest and its position in the tree match the format
//! that Alembic's own sources define, and the file contains nothing else.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use meniscus::internals::io::CoordinateWidth;
use meniscus::internals::io::alembic::SampleTime;
use meniscus::internals::io::alembic::content_hash::ContentHasher;
use meniscus::internals::io::alembic::frame_archive::FrameArchive;
use meniscus::internals::io::output::MeshFormat;
use meniscus::internals::io::series::SeriesFrame;
use meniscus::internals::particles::AttributeKind;
use meniscus::internals::surface::mesh::source::MeshSource;
use meniscus::internals::surface::mesh::{Mesh, VertexAttribute};
use meniscus::{Reconstruction, Simulation};

use crate::common::files::names;
use crate::common::shapes::{moved, sphere, with_attributes};

/// The complete content of an archive.
struct Archive {
    metadata: String,
    /// For each time sampling, its time per cycle, its times, and its number of samples.
    samplings: Vec<(f64, Vec<f64>, u32)>,
    /// Maps the path of each property, such as `/fluid/fluidShape/.geom/P`, to the values of the
    /// property.
    values: BTreeMap<String, Values>,
    /// Maps the path of each object and each compound property to its metadata.
    groups: BTreeMap<String, String>,
}

struct Values {
    bits: u32,
    metadata: String,
    sampling: u32,
    /// The bytes of each sample.
    samples: Vec<Vec<u8>>,
}

impl Values {
    fn words(&self, sample: usize) -> Vec<u32> {
        self.samples[sample].as_chunks().0.iter().map(|&word| u32::from_le_bytes(word)).collect()
    }

    fn floats(&self, sample: usize) -> Vec<f32> {
        self.words(sample).into_iter().map(f32::from_bits).collect()
    }
}

struct Reader<'a> {
    bytes: &'a [u8],
    listed: Vec<String>,
    /// Maps the start of each block that was read to the end of the block.
    read_blocks: BTreeMap<usize, usize>,
    found: Archive,
}

/// The offset of a child of a group.
#[derive(Clone, Copy)]
struct Child(u64);

fn word(bytes: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(bytes[at..][..8].try_into().unwrap())
}

/// Takes the next little-endian number of `width` bytes.
fn number(bytes: &mut &[u8], width: usize) -> u32 {
    let (number, rest) = bytes.split_at(width);
    *bytes = rest;
    number.iter().rev().fold(0, |all, &byte| all << 8 | u32::from(byte))
}

fn text(bytes: &mut &[u8], length: u32) -> String {
    let (text, rest) = bytes.split_at(length as usize);
    *bytes = rest;
    String::from_utf8(text.to_vec()).unwrap()
}

impl<'a> Reader<'a> {
    fn group(&mut self, Child(at): Child) -> Vec<Child> {
        assert_eq!(at >> 63, 0, "data instead of a group");
        if at == 0 {
            return Vec::new();
        }
        let at = at as usize;
        let count = word(self.bytes, at) as usize;
        self.read_blocks.insert(at, at + 8 + 8 * count);
        (0..count).map(|child| Child(word(self.bytes, at + 8 + 8 * child))).collect()
    }

    fn data(&mut self, Child(at): Child) -> &'a [u8] {
        assert_eq!(at >> 63, 1, "a group instead of data");
        let at = (at & !(1 << 63)) as usize;
        if at == 0 {
            return &[];
        }
        let length = word(self.bytes, at) as usize;
        self.read_blocks.insert(at, at + 8 + length);
        &self.bytes[at + 8..][..length]
    }

    fn metadata(&self, index: u32, explicit: impl FnOnce() -> String) -> String {
        match index {
            0 => String::new(),
            255 => explicit(),
            index => self.listed[index as usize - 1].clone(),
        }
    }

    fn object(&mut self, path: &str, object: Child) {
        let group = self.group(object);
        let [properties, children @ .., headers] = &group[..] else {
            panic!("the group of {path} is too short")
        };
        let headers = self.data(*headers);
        self.compound(path, *properties);
        let mut headers = &headers[..headers.len() - 32];
        for &child in children {
            let length = number(&mut headers, 4);
            let child_path = format!("{path}/{}", text(&mut headers, length));
            let index = number(&mut headers, 1);
            let metadata = self.metadata(index, || {
                let length = number(&mut headers, 4);
                text(&mut headers, length)
            });
            self.found.groups.insert(child_path.clone(), metadata);
            self.object(&child_path, child);
        }
        assert!(headers.is_empty(), "unread headers of {path}");
    }

    fn compound(&mut self, path: &str, compound: Child) {
        let group = self.group(compound);
        let Some((headers, properties)) = group.split_last() else { return };
        let mut headers = self.data(*headers);
        for &property in properties {
            let bits = number(&mut headers, 4);
            let width = 1 << (bits >> 2 & 3);
            let is_compound = bits & 3 == 0;
            let count = if is_compound { 0 } else { number(&mut headers, width) };
            assert_eq!(bits >> 9 & 1, 0, "unexpected range of changed samples");
            let sampling = if bits >> 8 & 1 == 1 { number(&mut headers, width) } else { 0 };
            let length = number(&mut headers, width);
            let path = format!("{path}/{}", text(&mut headers, length));
            let metadata = self.metadata(bits >> 20 & 255, || {
                let length = number(&mut headers, width);
                text(&mut headers, length)
            });
            if is_compound {
                self.found.groups.insert(path.clone(), metadata);
                self.compound(&path, property);
                continue;
            }
            let children = self.group(property);
            let is_scalar = bits & 3 == 1;
            let blocks = if is_scalar { 1 } else { 2 };
            assert_eq!(children.len(), blocks * count as usize, "number of samples of {path}");
            assert_eq!(bits >> 11 & 1 == 1, count < 2, "constant flag of {path}");
            let samples = children.chunks(blocks).map(|children| {
                assert!(
                    children[1..].iter().all(|child| child.0 == 1 << 63),
                    "unexpected dimensions of {path}"
                );
                let Some((digest, values)) = self.data(children[0]).split_at_checked(16) else {
                    return Vec::new();
                };
                assert_eq!(digest, ContentHasher::of(values), "digest of {path}");
                assert!(!values.is_empty(), "{path} has an empty block");
                values.to_vec()
            });
            let samples: Vec<_> = samples.collect();
            let is_homogeneous = samples.iter().all(|sample| sample.len() == samples[0].len());
            assert_eq!(bits >> 10 & 1 == 1, is_homogeneous, "homogeneous flag of {path}");
            let values = Values { bits, metadata, sampling, samples };
            self.found.values.insert(path, values);
        }
        assert!(headers.is_empty(), "unread headers of {path}");
    }
}

/// Reads an archive. Also returns the number of unused bytes, which contain earlier versions of
/// groups. All other bytes must belong to the archive.
fn read(bytes: &[u8]) -> (Archive, usize) {
    assert_eq!(bytes[..8], *b"Ogawa\xff\0\x01");
    let found = Archive {
        metadata: String::new(),
        samplings: Vec::new(),
        values: BTreeMap::new(),
        groups: BTreeMap::new(),
    };
    let mut reader = Reader { bytes, listed: Vec::new(), read_blocks: BTreeMap::new(), found };
    let root = reader.group(Child(word(bytes, 8)));
    let [version, library, top, metadata, samplings, listed] = root[..] else { panic!("root") };
    assert_eq!(reader.data(version), 0_i32.to_le_bytes());
    assert_eq!(reader.data(library), 10800_i32.to_le_bytes());
    reader.found.metadata = String::from_utf8(reader.data(metadata).to_vec()).unwrap();
    let mut samplings = reader.data(samplings);
    while !samplings.is_empty() {
        let samples = number(&mut samplings, 4);
        let mut double = || {
            let [low, high] = [(); 2].map(|()| u64::from(number(&mut samplings, 4)));
            f64::from_bits(high << 32 | low)
        };
        let per_cycle = double();
        let count = number(&mut samplings, 4);
        let times = (0..count).map(|_| {
            let [low, high] = [(); 2].map(|()| u64::from(number(&mut samplings, 4)));
            f64::from_bits(high << 32 | low)
        });
        let times = times.collect();
        reader.found.samplings.push((per_cycle, times, samples));
    }
    let mut listed = reader.data(listed);
    while !listed.is_empty() {
        let length = number(&mut listed, 1);
        reader.listed.push(text(&mut listed, length));
    }
    reader.object("", top);
    let mut end = 16;
    let mut unused = 0;
    for (&start, &after) in &reader.read_blocks {
        assert!(start >= end, "a block at {start} begins before {end}");
        unused += start - end;
        end = after;
    }
    assert_eq!(end, bytes.len(), "the last block does not end the file");
    (reader.found, unused)
}

fn written(mesh: &Mesh, time: f64) -> Vec<u8> {
    let mut bytes = Vec::new();
    let format = MeshFormat::Abc(SampleTime::of(time));
    format.write(&mut bytes, mesh, CoordinateWidth::F64).unwrap();
    bytes
}

fn narrow(mesh: &Mesh) -> Vec<f32> {
    mesh.positions.as_flattened().iter().map(|&x| x as f32).collect()
}

const SHAPE: &str = "/fluid/fluidShape/.geom";

#[test]
fn an_alembic_archive_contains_all_values_and_clockwise_triangles() {
    let mut mesh = with_attributes(moved(&sphere(1.0, 2), [0.5, 0.0, -3.0]));
    let vertices = mesh.positions.len();
    let whole: Vec<i64> = (0..vertices as i64).map(|number| number << 20).collect();
    let values = whole.iter().map(|&x| x as f32).collect();
    let kind = AttributeKind::Unsigned;
    mesh.attributes.extend([
        VertexAttribute { kind, whole: whole.clone(), ..VertexAttribute::new("id", 1, values) },
        VertexAttribute {
            kind: AttributeKind::ByteColour,
            ..VertexAttribute::new("Cd", 3, [0.0, 51.0, 255.0].repeat(vertices))
        },
        VertexAttribute::new("a/b c", 2, vec![0.25; 2 * vertices]),
        VertexAttribute::new("a_b_c", 9, vec![0.5; 9 * vertices]),
        VertexAttribute::new("N", 1, vec![4.0; vertices]),
    ]);
    let (archive, unused) = read(&written(&mesh, 1.25));
    assert_eq!(unused, 0);
    assert!(archive.metadata.starts_with("_ai_Application=meniscus "), "{}", archive.metadata);
    assert_eq!(archive.samplings, [(1.0, vec![0.0], 1), (1.0, vec![1.25], 1)]);
    let groups: Vec<_> = archive.groups.iter().map(|(a, b)| (a.as_str(), b.as_str())).collect();
    let schema = "schema=AbcGeom_PolyMesh_v1;schemaBaseType=AbcGeom_GeomBase_v1";
    assert_eq!(
        groups,
        [
            ("/fluid", "schema=AbcGeom_Xform_v3;schemaObjTitle=AbcGeom_Xform_v3:.xform"),
            ("/fluid/.xform", "schema=AbcGeom_Xform_v3"),
            ("/fluid/fluidShape", &*format!("{schema};schemaObjTitle=AbcGeom_PolyMesh_v1:.geom")),
            (SHAPE, schema),
            (&*format!("{SHAPE}/.arbGeomParams"), ""),
        ]
    );
    assert_eq!(archive.values["/fluid/.xform/.inherits"].samples, [[1]]);
    assert_eq!(archive.values["/fluid/.xform/.inherits"].sampling, 0);

    // Check a property's type, its elements' number of components, and its metadata.
    let of = |name: &str, pod: u32, extent: u32, metadata: &str| {
        let values = &archive.values[&format!("{SHAPE}/{name}")];
        assert_eq!((values.bits >> 4 & 15, values.bits >> 12 & 255), (pod, extent), "{name}");
        assert_eq!((&*values.metadata, values.sampling), (metadata, 1), "{name}");
        values
    };
    let [u32, i32, f32, f64] = [5, 6, 10, 11];
    let points = of("P", f32, 3, "geoScope=vtx;interpretation=point");
    assert_eq!(points.floats(0), narrow(&mesh));
    let corners = of(".faceIndices", i32, 1, "");
    let clockwise: Vec<u32> = mesh.triangles.iter().flat_map(|&[a, b, c]| [a, c, b]).collect();
    assert_eq!(corners.words(0), clockwise);
    assert_eq!(of(".faceCounts", i32, 1, "").words(0), vec![3; mesh.triangles.len()]);
    let normals = of(
        "N",
        f32,
        3,
        "arrayExtent=1;geoScope=vtx;interpretation=normal;isGeomParam=true;podExtent=3;\
         podName=float32_t",
    );
    assert_eq!(normals.floats(0), mesh.normals.as_ref().unwrap().as_flattened());
    let velocity = mesh.attributes.iter().find(|attribute| attribute.name == "velocity").unwrap();
    let velocities = of(".velocities", f32, 3, "interpretation=vector");
    assert_eq!(velocities.floats(0), velocity.values);
    let bounds = of(".selfBnds", f64, 6, "interpretation=box");
    let doubles = bounds.samples[0].as_chunks().0.iter().map(|&x| f64::from_le_bytes(x));
    let fold = |axis: usize, pick: fn(f32, f32) -> f32| {
        f64::from(narrow(&mesh)[axis..].iter().step_by(3).copied().reduce(pick).unwrap())
    };
    let ends = |pick: fn(f32, f32) -> f32| [0, 1, 2].map(|axis| fold(axis, pick));
    let expected = [ends(f32::min), ends(f32::max)];
    assert_eq!(doubles.collect::<Vec<_>>(), expected.as_flattened());

    let more = |name: &str, pod, extent, times: usize, meaning: &str, pod_name: &str| {
        let metadata = format!(
            "arrayExtent={times};geoScope=vtx;{meaning}podExtent={extent};podName={pod_name}"
        );
        of(&format!(".arbGeomParams/{name}"), pod, extent, &metadata)
    };
    let id = more("id", u32, 1, 1, "isGeomParam=true;", "uint32_t").words(0);
    assert!(id.iter().map(|&id| i64::from(id)).eq(whole));
    let meaning = "interpretation=rgb;isGeomParam=true;";
    assert_eq!(more("Cd", f32, 3, 1, meaning, "float32_t").floats(0)[..3], [0.0, 0.2, 1.0]);
    let meaning = "interpretation=vector;isGeomParam=true;notUV=1;";
    let pairs = more("a_b_c", f32, 2, 1, meaning, "float32_t");
    assert_eq!(pairs.floats(0), vec![0.25; 2 * vertices]);
    let nine = more("a_b_c_", f32, 1, 9, "isGeomParam=true;", "float32_t");
    assert_eq!(nine.floats(0).len(), 9 * vertices);
    more("N_", f32, 1, 1, "isGeomParam=true;", "float32_t");
    let infos: Vec<_> = mesh.attributes.iter().map(VertexAttribute::info).collect();
    let renamed = MeshFormat::Abc(SampleTime::ZERO).renamed(&infos, true);
    assert_eq!(
        renamed,
        [["a/b c", "a_b_c"], ["a_b_c", "a_b_c_"], ["N", "N_"]].map(|both| both.map(str::to_owned))
    );
}

#[test]
fn an_empty_alembic_mesh_has_empty_arrays_and_bounds() {
    let (archive, _) = read(&written(&Mesh::default(), 0.0));
    for name in ["P", ".faceIndices", ".faceCounts"] {
        assert!(archive.values[&format!("{SHAPE}/{name}")].samples[0].is_empty(), "{name}");
    }
    let bounds = &archive.values[&format!("{SHAPE}/.selfBnds")].samples[0];
    let expected = [[f64::MAX; 3], [f64::MIN; 3]].as_flattened().to_vec();
    assert_eq!(
        bounds.as_chunks().0.iter().map(|&x| f64::from_le_bytes(x)).collect::<Vec<_>>(),
        expected
    );
}

#[test]
fn an_alembic_archive_is_independent_of_the_number_of_threads() {
    let mesh = with_attributes(sphere(1.0, 6));
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| written(&mesh, 0.5))
    };
    assert_eq!(on(1), on(3));
}

#[test]
fn metadata_and_names_of_any_length_are_preserved() {
    let mut mesh = sphere(1.0, 1);
    let vertices = mesh.positions.len();
    let long = "x".repeat(300);
    mesh.attributes = vec![VertexAttribute::new(&*long, 1, vec![1.0; vertices])];
    // Use more distinct metadata than the archive's list can hold.
    let widths = 5..280;
    let wide = widths.clone().map(|components| {
        let name = format!("wide{components}");
        VertexAttribute::new(&*name, components, vec![2.0; components * vertices])
    });
    mesh.attributes.extend(wide);
    let (archive, _) = read(&written(&mesh, 0.0));
    assert!(archive.values.contains_key(&format!("{SHAPE}/.arbGeomParams/{long}")));
    for components in widths {
        let values = &archive.values[&format!("{SHAPE}/.arbGeomParams/wide{components}")];
        assert!(values.metadata.starts_with(&format!("arrayExtent={components};")));
        assert_eq!(values.floats(0).len(), components * vertices);
    }
}

/// Writes a mesh to a file in the folder of an archive's frames.
fn frame_file(folder: &Path, number: i64, mesh: &Mesh) -> SeriesFrame {
    let (file, bytes) = (format!("wave_{number}.abc"), written(mesh, number as f64));
    fs::create_dir_all(folder).unwrap();
    fs::write(folder.join(&file), &bytes).unwrap();
    SeriesFrame {
        frame: number,
        time: None,
        file,
        bytes: bytes.len() as u64,
        particles: 1,
        vertices: mesh.vertex_count(),
        triangles: mesh.triangle_count(),
        bounds: None,
        normals: mesh.has_normals(),
        attributes: mesh.attributes(),
    }
}

fn numbers(frames: &[SeriesFrame]) -> Vec<f64> {
    frames.iter().map(|frame| frame.frame as f64).collect()
}

/// An archive in a folder, and the folder of its frames.
fn archive_in(folder: &Path) -> (FrameArchive, std::path::PathBuf) {
    let frames = folder.join("wave.abc.frames");
    (FrameArchive::new(folder.join("wave.abc"), frames.clone()), frames)
}

#[test]
fn a_frame_archive_is_complete_after_each_added_frame() {
    let folder = tempfile::tempdir().unwrap();
    let (archive, frames) = archive_in(folder.path());
    // Frame 2 has no attributes, frame 4 has an empty mesh, and frame 3 is added last.
    let meshes = [
        (1, with_attributes(sphere(1.0, 2))),
        (2, sphere(1.5, 1)),
        (4, Mesh::default()),
        (5, with_attributes(moved(&sphere(0.5, 2), [0.0, 1.0, 0.0]))),
        (3, with_attributes(sphere(2.0, 1))),
    ];
    let mut expected: BTreeMap<i64, &Mesh> = BTreeMap::new();
    for (number, mesh) in &meshes {
        let listed = frame_file(&frames, *number, mesh);
        archive.add(&listed, 7, numbers).unwrap();
        assert!(archive.frames().holds(&listed));
        expected.insert(*number, mesh);
        assert_eq!(names(&frames), ["archive.json"], "the file of the frame remains");
        let (found, _) = read(&fs::read(archive.path()).unwrap());
        let (first, count) = (*expected.keys().next().unwrap() as f64, expected.len() as u32);
        let (per_cycle, times, samples) = &found.samplings[1];
        let is_uniform = times.len() == 1;
        assert_eq!((times[0], *samples), (first, count));
        assert_eq!(is_uniform, expected.keys().copied().eq(1..=i64::from(count)));
        assert_eq!(*per_cycle, if is_uniform { 1.0 } else { f64::MAX / 32.0 });
        let of = |name: &str| &found.values[&format!("{SHAPE}/{name}")];
        for (sample, mesh) in expected.values().enumerate() {
            assert_eq!(of("P").floats(sample), narrow(mesh));
            assert_eq!(of(".faceCounts").words(sample), vec![3; mesh.triangles.len()]);
            let velocity = mesh.attributes.iter().find(|info| info.name == "velocity");
            let velocity = velocity.map_or(&[][..], |velocity| &velocity.values);
            assert_eq!(of(".velocities").floats(sample), velocity);
            assert_eq!(of(".selfBnds").samples[sample].len(), 48);
        }
    }
    // A frame of a conversion with a different state starts a new archive.
    let listed = frame_file(&frames, 9, &meshes[1].1);
    archive.add(&listed, 8, numbers).unwrap();
    let (found, unused) = read(&fs::read(archive.path()).unwrap());
    assert_eq!(found.values[&format!("{SHAPE}/P")].samples.len(), 1);
    assert_eq!(unused, 16 + (listed.bytes - end_of_arrays(&meshes[1].1)) as usize);
}

/// The offset at which the arrays end in the file of a mesh.
fn end_of_arrays(mesh: &Mesh) -> u64 {
    let arrays =
        [12 * mesh.vertex_count(), 48, 12 * mesh.triangle_count(), 4 * mesh.triangle_count()];
    16 + arrays.into_iter().map(|bytes| 24 + bytes).sum::<u64>()
}

#[test]
fn an_interrupted_archive_addition_resumes_to_the_same_bytes() {
    let meshes = [1, 2, 3].map(|number| with_attributes(sphere(f64::from(number), 1)));
    let add = |archive: &FrameArchive, frames: &Path, number: usize| {
        let listed = frame_file(frames, number as i64, &meshes[number - 1]);
        archive.add(&listed, 7, numbers).unwrap();
    };
    let folder = tempfile::tempdir().unwrap();
    let (archive, frames) = archive_in(folder.path());
    let table = frames.join("archive.json");
    add(&archive, &frames, 1);
    add(&archive, &frames, 2);
    let before = [archive.path(), &table].map(|path| fs::read(path).unwrap());
    add(&archive, &frames, 3);
    let whole = fs::read(archive.path()).unwrap();
    assert_eq!(
        whole[16..before[0].len()],
        before[0][16..],
        "an addition changes more than the header"
    );
    let resume = |bytes: &[u8], table_bytes: &[u8]| {
        fs::write(archive.path(), bytes).unwrap();
        fs::write(&table, table_bytes).unwrap();
        let known = archive.frames();
        assert_eq!(known.crc(1), Some(crc32fast::hash(&written(&meshes[0], 1.0))));
        let (found, _) = read(&bytes[..before[0].len()]);
        assert_eq!(found.values[&format!("{SHAPE}/P")].samples.len(), 2);
        add(&archive, &frames, 3);
        assert!(fs::read(archive.path()).unwrap() == whole);
        assert_eq!(names(&frames), ["archive.json"]);
    };
    // Simulate a crash while the frame and the groups are written.
    for kept in [0, 1, 100, whole.len() - before[0].len()] {
        let bytes = [&before[0][..], &whole[before[0].len()..][..kept]].concat();
        resume(&bytes, &before[1]);
    }
    // Simulate a crash after the header is written and before the table is written.
    fs::write(archive.path(), &whole).unwrap();
    fs::write(&table, &before[1]).unwrap();
    add(&archive, &frames, 3);
    assert!(fs::read(archive.path()).unwrap() == whole);
    // Simulate a crash before the frame's own file is removed.
    add(&archive, &frames, 3);
    assert!(fs::read(archive.path()).unwrap() == whole);
    // A truncated archive counts as having no frames.
    fs::write(archive.path(), &whole[..whole.len() - 1]).unwrap();
    assert_eq!(archive.frames().crc(1), None);
}

#[test]
fn a_simulation_archive_is_independent_of_threads_and_resume() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::create_dir(at("in")).unwrap();
    let write = |number: i32| {
        let mut text = String::new();
        for cell in 0..4_i32.pow(3) * number {
            let place = [cell % 4, cell / 4 % 4, cell / 16];
            text += &format!("{} {} {}\n", place[0], place[1], place[2]);
        }
        fs::write(at(&format!("in/f_{number}.xyz")), text).unwrap();
    };
    (1..=5).for_each(write);
    let request = |threads| Reconstruction::new().spacing(1.0).threads(threads);
    let simulation = |output: &str, threads| {
        let inputs = folder.path().join("in/f_{}.xyz");
        Simulation::new(inputs, at(output)).reconstruction(request(threads)).fps(25.0)
    };
    let run = |simulation: Simulation| simulation.run(|_| {}).unwrap();
    let summaries = run(simulation("one/wave.abc", 1));
    assert_eq!((summaries[0].made, &*summaries[0].folder), (5, &*at("one")));
    run(simulation("three/wave.abc", 3));
    let bytes = fs::read(at("one/wave.abc")).unwrap();
    assert!(bytes == fs::read(at("three/wave.abc")).unwrap());
    let (found, _) = read(&bytes);
    let (per_cycle, first, samples) = &found.samplings[1];
    assert!((per_cycle - 0.04).abs() < 1e-12, "{per_cycle}");
    assert_eq!((&first[..], *samples), (&[0.04][..], 5));

    run(simulation("each/wave_{}.abc", 2));
    for (sample, number) in (1..=5).enumerate() {
        let bytes = fs::read(at(&format!("each/wave_{number}.abc"))).unwrap();
        let (single, _) = read(&bytes);
        assert_eq!(single.samplings[1].1, [f64::from(number) / 25.0]);
        for (name, values) in single.values.iter().filter(|(name, _)| name.contains(".geom")) {
            assert!(found.values[name].samples[sample] == values.samples[0], "{name}");
        }
    }
    assert!(!at("each/wave.abc").exists(), "a run with a pattern made an archive");

    run(simulation("later/wave.abc", 2).end(3));
    let refused = simulation("later/wave.abc", 2).run(|_| {}).unwrap_err();
    assert!(refused.to_string().contains("wave.abc"), "{refused}");
    let summaries = run(simulation("later/wave.abc", 2).resume());
    assert_eq!(summaries[0].made, 2);
    assert!(bytes == fs::read(at("later/wave.abc")).unwrap());
    // If an input has changed, a new frame replaces the frame of this input in the archive. With
    // `overwrite`, the library writes a new archive, which is smaller than the first one, because
    // frame 4 now has fewer particles.
    fs::write(at("in/f_4.xyz"), fs::read(at("in/f_2.xyz")).unwrap()).unwrap();
    assert_eq!(run(simulation("later/wave.abc", 2).resume())[0].made, 1);
    let (changed, _) = read(&fs::read(at("later/wave.abc")).unwrap());
    let points = &changed.values[&format!("{SHAPE}/P")].samples;
    assert!(points.len() == 5 && points[3] == points[1]);
    run(simulation("later/wave.abc", 2).overwrite());
    assert!(fs::metadata(at("later/wave.abc")).unwrap().len() < bytes.len() as u64);
}
