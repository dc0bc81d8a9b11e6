//! Tests of the listings that a simulation writes for other programs, and of a USD stage with its
//! layers. Listings must be valid after each frame.

use std::fs;
use std::path::Path;

use meniscus::internals::io::alembic::SampleTime;
use meniscus::internals::io::glb::GlbLayout;
use meniscus::internals::io::output::{MeshFormat, MeshOutput};
use meniscus::internals::io::series::{Series, SeriesFrame};
use meniscus::internals::io::whole::Replace;
use meniscus::internals::io::{CoordinateWidth, UpAxis, WriteFault};
use meniscus::internals::surface::mesh::Mesh;
use meniscus::internals::surface::mesh::source::MeshSource;
use serde_json::Value;

use crate::common::files::names;
use crate::common::shapes::{moved, sphere, with_attributes};

fn series(folder: &Path, format: MeshFormat, fps: Option<f64>) -> Series {
    Series { format, simulation: folder.join(format!("pool{format}")), fps, up: UpAxis::Z }
}

fn frame(frame: i64, file: &str, time: Option<f64>) -> SeriesFrame {
    let mesh = with_attributes(sphere(1.0, 1));
    SeriesFrame {
        frame,
        time,
        file: file.into(),
        bytes: 9,
        particles: 7,
        vertices: mesh.vertex_count(),
        triangles: mesh.triangle_count(),
        bounds: Some([[-1.0; 3], [1.0; 3]]),
        normals: mesh.has_normals(),
        attributes: MeshSource::attributes(&mesh),
    }
}

#[test]
fn listings_contain_every_frame_with_its_time() {
    let folder = tempfile::tempdir().unwrap();
    let series = series(folder.path(), MeshFormat::Vtp, None);
    let frames = [frame(1, "pool_1.vtp", Some(0.05)), frame(2, "pool_2 & \"3\".vtp", Some(0.08))];
    series.write(&frames[1..]).unwrap();
    series.write(&frames).unwrap();
    assert_eq!(names(folder.path()), ["pool.pvd", "pool.vtp.json", "pool.vtp.series"]);
    let text = |name: &str| fs::read_to_string(folder.path().join(name)).unwrap();
    assert_eq!(
        text("pool.pvd"),
        "<?xml version=\"1.0\"?>\n<VTKFile type=\"Collection\" version=\"0.1\">\n<Collection>\n\
         <DataSet timestep=\"0.05\" part=\"0\" file=\"pool_1.vtp\"/>\n\
         <DataSet timestep=\"0.08\" part=\"0\" file=\"pool_2 &amp; &quot;3&quot;.vtp\"/>\n\
         </Collection>\n</VTKFile>\n"
    );
    let json: Value = serde_json::from_str(&text("pool.vtp.series")).unwrap();
    assert_eq!(json["file-series-version"], "1.0");
    assert_eq!(
        (&json["files"][1]["name"], &json["files"][1]["time"]),
        (&"pool_2 & \"3\".vtp".into(), &0.08.into())
    );
    let json: Value = serde_json::from_str(&text("pool.vtp.json")).unwrap();
    assert_eq!((&json["up"], &json["fps"]), (&"Z".into(), &Value::Null));
    let listed: Vec<SeriesFrame> = serde_json::from_value(json["frames"].clone()).unwrap();
    assert_eq!(listed, frames);
}

#[test]
fn listed_times_come_from_the_files_if_increasing_or_else_from_the_fps() {
    let folder = tempfile::tempdir().unwrap();
    let listed = |fps: Option<f64>, times: [Option<f64>; 2]| -> [f64; 2] {
        let series = series(folder.path(), MeshFormat::Obj, fps);
        series.write(&[frame(3, "a.obj", times[0]), frame(5, "b.obj", times[1])]).unwrap();
        let json: Value = serde_json::from_slice(&fs::read(&series.files()[0]).unwrap()).unwrap();
        [0, 1].map(|i| json["frames"][i]["time"].as_f64().unwrap())
    };
    assert_eq!(listed(Some(25.0), [Some(0.1), Some(0.3)]), [0.1, 0.3]);
    for missing in [[None, None], [Some(0.1), None], [Some(0.1), Some(0.1)], [Some(0.3), Some(0.1)]]
    {
        assert_eq!(listed(Some(25.0), missing), [3.0 / 25.0, 5.0 / 25.0], "{missing:?}");
        assert_eq!(listed(None, missing), [3.0, 5.0], "{missing:?}");
    }
}

#[test]
fn each_mesh_format_has_its_own_listings() {
    let folder = tempfile::tempdir().unwrap();
    for (format, expected) in [
        (MeshFormat::Ply, &["pool.ply.json", "pool.ply.series"][..]),
        (MeshFormat::Vtk, &["pool.vtk.json", "pool.vtk.series"]),
        (MeshFormat::Stl, &["pool.stl.json", "pool.stl.series"]),
        (MeshFormat::Obj, &["pool.obj.json"]),
        (MeshFormat::Glb(GlbLayout::PLAIN), &["pool.glb.json"]),
        (MeshFormat::Abc(SampleTime::ZERO), &["pool.abc.json"]),
        (MeshFormat::Usdc(UpAxis::Y), &["pool.usdc.json", "pool.manifest.usda", "pool.usda"]),
    ] {
        let files = series(folder.path(), format, None).files();
        assert_eq!(files, expected.iter().map(|name| folder.path().join(name)).collect::<Vec<_>>());
    }
}

#[test]
fn writing_listings_into_a_missing_folder_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let error = series(&folder.path().join("gone"), MeshFormat::Vtk, None).write(&[]).unwrap_err();
    assert!(matches!(error.fault, WriteFault::Io(_)), "{error}");
}

#[test]
fn a_usd_stage_shows_each_layer_from_its_own_time() {
    let folder = tempfile::tempdir().unwrap();
    let series = series(folder.path(), MeshFormat::Usdc(UpAxis::Z), Some(25.0));
    let frames = [(1, "f1.usdc", 0.04), (3, "f3.usdc", 0.12), (4, "f@4.usdc", 0.17)];
    series.write(&frames.map(|(number, name, time)| frame(number, name, Some(time)))).unwrap();
    assert_eq!(names(folder.path()), ["pool.manifest.usda", "pool.usda", "pool.usdc.json"]);
    let stage = fs::read_to_string(folder.path().join("pool.usda")).unwrap();
    for line in [
        "upAxis = \"Z\"",
        "timeCodesPerSecond = 25",
        "startTimeCode = 1\n",
        "endTimeCode = 5\n",
        "asset[] assetPaths = [@./f1.usdc@, @./f3.usdc@, @@@./f@4.usdc@@@]",
        "double2[] active = [(1, 0), (3, 1), (4.25, 2)]",
        "double2[] times = [(1, 0), (3, 2), (3, 0), (4.25, 1.25), (4.25, 0)]",
        "asset manifestAssetPath = @./pool.manifest.usda@",
        "uniform token subdivisionScheme = \"none\"",
        "vector3f[] velocities\n",
    ] {
        assert!(stage.contains(line), "{line} is not in {stage}");
    }
    let manifest = fs::read_to_string(folder.path().join("pool.manifest.usda")).unwrap();
    for line in ["point3f[] points\n", "vector3f[] velocities\n", "normal3f[] normals (\n"] {
        assert!(manifest.contains(line), "{line} is not in {manifest}");
    }
}

/// The text of a stage that plays frames with these times.
fn stage_of(fps: Option<f64>, times: &[f64]) -> String {
    let folder = tempfile::tempdir().unwrap();
    let series = series(folder.path(), MeshFormat::Usdc(UpAxis::Y), fps);
    let frames = (0..).zip(times).map(|(number, &time)| frame(number, "f.usdc", Some(time)));
    series.write(&frames.collect::<Vec<_>>()).unwrap();
    fs::read_to_string(folder.path().join("pool.usda")).unwrap()
}

#[test]
fn a_usd_stage_plays_every_frame_of_times_with_six_digits() {
    let printed: Vec<f64> =
        (0..12).map(|f| format!("{:.6}", f64::from(f) / 24.0).parse().unwrap()).collect();
    let active: Vec<String> = (0..12).map(|f| format!("({f}, {f})")).collect();
    for fps in [Some(24.0), None] {
        let stage = stage_of(fps, &printed);
        for line in [
            "timeCodesPerSecond = 24\n",
            "startTimeCode = 0\n",
            "endTimeCode = 11\n",
            &*format!("active = [{}]\n", active.join(", ")),
        ] {
            assert!(stage.contains(line), "{line} is not in {stage}");
        }
    }
    // The range of the stage is rounded outwards, so that it includes frames between time codes.
    let stage = stage_of(Some(24.0), &[0.020_833, 0.500_047, 0.900_049]);
    for line in ["startTimeCode = 0\n", "endTimeCode = 22\n", "(12, 1), (21.6"] {
        assert!(stage.contains(line), "{line} is not in {stage}");
    }
}

#[test]
fn evenly_spaced_times_set_the_rate_of_a_stage_unless_one_is_given() {
    for (fps, times, lines) in [
        (None, &[0.0, 0.04, 0.08, 0.12][..], ["PerSecond = 25\n", "endTimeCode = 3\n"]),
        (None, &[1.0, 1.1, 1.4], ["PerSecond = 10\n", "startTimeCode = 10\n"]),
        (None, &[0.0, 0.04, 0.1, 0.13], ["PerSecond = 24\n", "endTimeCode = 4\n"]),
        (Some(50.0), &[0.0, 0.04, 0.08], ["PerSecond = 50\n", "endTimeCode = 4\n"]),
    ] {
        let stage = stage_of(fps, times);
        assert!(lines.iter().all(|line| stage.contains(line)), "{lines:?} are not in {stage}");
    }
}

#[test]
fn a_list_of_usd_layers_has_the_time_codes_of_the_stage() {
    let folder = tempfile::tempdir().unwrap();
    for (format, codes) in
        [(MeshFormat::Usdc(UpAxis::Y), [Some(1.0), Some(2.0)]), (MeshFormat::Ply, [None; 2])]
    {
        let series = series(folder.path(), format, Some(24.0));
        series.write(&[frame(7, "a", Some(0.041_667)), frame(8, "b", Some(0.083_333))]).unwrap();
        let json: Value = serde_json::from_slice(&fs::read(&series.files()[0]).unwrap()).unwrap();
        assert_eq!([0, 1].map(|i| json["frames"][i]["time_code"].as_f64()), codes, "{format}");
        assert_eq!(
            [0, 1].map(|i| json["frames"][i]["time"].as_f64().unwrap()),
            [0.041_667, 0.083_333]
        );
    }
}

#[test]
fn late_frames_of_an_archive_have_the_times_of_whole_frames() {
    let times = |fps: Option<f64>, times: &[f64]| {
        let series = series(Path::new(""), MeshFormat::Abc(SampleTime::ZERO), fps);
        let frames = (0..).zip(times).map(|(number, &time)| frame(number, "f.abc", Some(time)));
        series.times(&frames.collect::<Vec<_>>())
    };
    let late = [0.0, 0.0404, 0.0804, 0.1204];
    for fps in [Some(25.0), None] {
        assert_eq!(times(fps, &late), [0.0, 1.0 / 25.0, 2.0 / 25.0, 3.0 / 25.0]);
    }
    // If no rate is given, uneven times are kept exactly.
    assert_eq!(times(None, &[0.0, 0.04, 0.1, 0.13]), [0.0, 0.04, 0.1, 0.13]);
}

#[cfg(unix)]
#[test]
fn a_stage_path_has_no_backslash_and_its_name_no_control_character() {
    let fault = |simulation: &str, format: MeshFormat| {
        let series = Series { format, simulation: simulation.into(), fps: None, up: UpAxis::Y };
        series.path_fault()
    };
    let usd = MeshFormat::Usdc(UpAxis::Y);
    for bad in ["/a/b\\c.usdc", "/a\\b/c.usdc", "a\\b.usdc", "/a/b\tc.usdc", "/a/b\u{85}c.usdc"] {
        assert!(fault(bad, usd).is_some(), "{bad:?}");
        assert_eq!(fault(&bad.replace("usdc", "ply"), MeshFormat::Ply), None, "{bad:?}");
    }
    for good in ["/a/b@ c.usdc", "/a\tb/c.usdc", "/ä/ö.usdc"] {
        assert_eq!(fault(good, usd), None, "{good:?}");
    }
}

fn layer(mesh: &Mesh) -> Vec<u8> {
    layer_with(mesh, UpAxis::Y)
}

fn layer_with(mesh: &Mesh, up: UpAxis) -> Vec<u8> {
    let mut bytes = Vec::new();
    MeshFormat::Usdc(up).write(&mut bytes, mesh, CoordinateWidth::F32).unwrap();
    bytes
}

fn word(bytes: &[u8], at: u64) -> u64 {
    u64::from_le_bytes(bytes[at as usize..][..8].try_into().unwrap())
}

#[test]
fn a_usd_layer_contains_raw_arrays_and_valid_section_offsets() {
    let mesh = with_attributes(moved(&sphere(1.0, 2), [0.5, 0.0, -3.0]));
    let bytes = layer(&mesh);
    assert_eq!(bytes[..16], *b"PXR-USDC\0\x08\0\0\0\0\0\0");
    let contents = word(&bytes, 16);
    assert_eq!(word(&bytes, contents), 6);
    let mut end = None;
    for (section, name) in (0..).zip(["TOKENS", "STRINGS", "FIELDS", "FIELDSETS", "PATHS", "SPECS"])
    {
        let entry = contents + 8 + 32 * section;
        assert!(bytes[entry as usize..].starts_with(name.as_bytes()));
        let start = word(&bytes, entry + 16);
        assert_eq!(end.unwrap_or(start), start, "{name}");
        end = Some(start + word(&bytes, entry + 24));
    }
    assert_eq!(end, Some(contents));
    assert_eq!(bytes.len() as u64, contents + 8 + 6 * 32);

    let vertices = mesh.positions.len() as u64;
    assert_eq!(word(&bytes, 88), vertices);
    let floats = |at: u64, count: usize| -> Vec<f32> {
        bytes[at as usize..][..4 * count]
            .chunks(4)
            .map(|b| f32::from_le_bytes(b.try_into().unwrap()))
            .collect()
    };
    let points: Vec<f32> = mesh.positions.as_flattened().iter().map(|&x| x as f32).collect();
    assert_eq!(floats(96, points.len()), points);
    let after = |at: u64, bytes: u64| at + 8 + bytes.next_multiple_of(8);
    let triangles = mesh.triangles.len() as u64;
    let counts = after(88, 12 * vertices);
    assert_eq!((word(&bytes, counts), word(&bytes, counts + 8)), (triangles, 3 << 32 | 3));
    let corners = after(counts, 4 * triangles);
    let [a, b, _] = mesh.triangles[0];
    assert_eq!(
        (word(&bytes, corners), word(&bytes, corners + 8)),
        (3 * triangles, u64::from(b) << 32 | u64::from(a))
    );
    let extent = floats(after(corners, 12 * triangles) + 8, 6);
    let fold = |axis: usize, pick: fn(f32, f32) -> f32| {
        points[axis..].iter().step_by(3).copied().reduce(pick).unwrap()
    };
    for axis in 0..3 {
        assert_eq!((extent[axis], extent[axis + 3]), (fold(axis, f32::min), fold(axis, f32::max)));
    }
}

#[test]
fn a_usd_layer_is_independent_of_threads_and_extension() {
    let folder = tempfile::tempdir().unwrap();
    let mesh = with_attributes(sphere(1.0, 5));
    let on = |threads| {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap()
            .install(|| layer(&mesh))
    };
    let bytes = on(1);
    assert_eq!(bytes, on(3));
    for name in ["a.usdc", "a.usd"] {
        let path = folder.path().join(name);
        MeshOutput::prepare(&path, Replace::Refuse)
            .unwrap()
            .write(&mesh, CoordinateWidth::F32)
            .unwrap();
        assert_eq!(fs::read(path).unwrap(), bytes);
    }
}
