//! Tests of the readers of particle files: they return the written values, reject damaged files,
//! and never panic.

use std::io::{Seek, Write};
use std::path::Path;

use meniscus::internals::io::bytes::{Bytes, Unpacking, open_bytes};
use meniscus::internals::io::input::{self, InputFormat};
use meniscus::internals::io::scene::spacing_from_scene;
use meniscus::internals::io::text_format::TextHint;
use meniscus::internals::io::wanted::{WantedAttributes, WantedParticles};
use meniscus::internals::io::{
    ParticleFile, ReadError, ReadFault, UnreadPart, bgeo, bi4, json, npy, npz, ply, text_format,
    vtk, vtp,
};
use meniscus::internals::particles::selection::SelectionFault;
use meniscus::internals::particles::sizes::SizeChoice;
use meniscus::internals::particles::{Particles, RereadError, velocity_attribute};
use zip::CompressionMethod;

use crate::build::{self, Bi4, Compressor, Placed, VtkXml, gzip, tuples, xz};
use crate::common::files::data;
use crate::common::particle_files::{attribute, positions};
use crate::memory;

/// A function that compresses the bytes of a file.
type Packer = fn(&[u8]) -> Vec<u8>;

/// Compressions of complete files, by the extensions that they add.
const PACKERS: [(&str, Packer); 3] = [
    ("gz", gzip),
    ("xz", xz),
    ("zst", |bytes| zstd::encode_all(bytes, 3).expect("memory accepts all bytes")),
];

type Reader = fn(Bytes) -> Result<ParticleFile, ReadFault>;

const TEXT: Reader = |bytes| read_text(bytes, InputFormat::Csv, None, WantedAttributes::All);
const XYZ: Reader = |bytes| read_text(bytes, InputFormat::Xyz, None, WantedAttributes::All);
const VTK: Reader = |bytes| vtk::read_particles(bytes, Unpacking::in_memory());
const VTU: Reader = |bytes| vtp::read_particles(bytes, Unpacking::in_memory());
const NPY: Reader = |bytes| npy::read_particles(bytes, None);
const NPZ: Reader = |bytes| npz::read_particles(bytes, None, Unpacking::in_memory());

fn read_text(
    bytes: Bytes,
    format: InputFormat,
    step: Option<u64>,
    wanted: WantedAttributes,
) -> Result<ParticleFile, ReadFault> {
    let hint = TextHint::Extension(Some(format));
    text_format::read_particles(bytes, hint, (None, step), wanted, Unpacking::in_memory())
}

/// Opens particles with enough memory to unpack them.
fn open_particles(path: &Path) -> Result<ParticleFile, ReadError> {
    input::open_particles(
        path,
        Unpacking { in_memory: 1 << 40, scratch: Path::new("nowhere"), control: None },
    )
}

fn attributes(file: &ParticleFile) -> Vec<(&str, usize)> {
    file.particles.attributes().iter().map(|info| (info.name.as_str(), info.components)).collect()
}

fn bounds(positions: &[[f64; 3]]) -> [[f64; 3]; 2] {
    let fold = |start: f64, pick: fn(f64, f64) -> f64| {
        [0, 1, 2].map(|axis| positions.iter().map(|p| p[axis]).fold(start, pick))
    };
    [fold(f64::INFINITY, f64::min), fold(f64::NEG_INFINITY, f64::max)]
}

fn read(reader: Reader, bytes: &[u8]) -> Result<ParticleFile, ReadFault> {
    reader(bytes.to_vec().into())
}

fn text(text: &str) -> Result<ParticleFile, ReadFault> {
    read(TEXT, text.as_bytes())
}

fn fault(result: Result<ParticleFile, ReadFault>) -> String {
    result.expect_err("a fault").to_string()
}

/// A small file of every binary format and layout.
fn samples() -> Vec<(&'static str, Reader, Vec<u8>)> {
    let points = tuples(7);
    let mut samples: Vec<(&str, Reader, Vec<u8>)> = vec![
        ("bgeo", bgeo::read_particles, build::bgeo(&points)),
        ("raw.xyz", XYZ, build::raw(&points)),
    ];
    for descr in ["<f4", "<f8", ">f4", ">f8"] {
        for fortran in [false, true] {
            samples.push(("npy", NPY, build::npy(&points, descr, fortran)));
        }
    }
    for big in [false, true] {
        for wide in [false, true] {
            for double in [false, true] {
                for mixed in [false, true] {
                    let layout = Bi4 { big, wide, double, mixed, pieces: 1, piece: 0 };
                    samples.push(("bi4", bi4::read_particles, layout.build(&points)));
                }
            }
        }
    }
    samples
}

/// A small file of every format with encoded numbers.
fn encoded_samples() -> Vec<(&'static str, Reader, Vec<u8>)> {
    let points = tuples(7);
    let mut samples: Vec<(&str, Reader, Vec<u8>)> =
        VtkXml::all().into_iter().map(|layout| ("vtu", VTU, layout.build(&points))).collect();
    for compression in [CompressionMethod::Stored, CompressionMethod::Deflated] {
        samples.push(("npz", NPZ, build::npz_frame(&points, compression)));
    }
    samples
}

#[test]
fn a_single_particle_is_read_in_any_array_order() {
    let points = tuples(1);
    for descr in ["<f4", "<f8", ">f4", ">f8"] {
        for fortran in [false, true] {
            let file = read(NPY, &build::npy(&points, descr, fortran));
            assert_eq!(positions(&file.unwrap()), points, "{descr}, Fortran order: {fortran}");
        }
    }
    for compression in [CompressionMethod::Stored, CompressionMethod::Deflated] {
        let file = read(NPZ, &build::npz_frame(&points, compression)).unwrap();
        assert_eq!(positions(&file), points, "{compression:?}");
    }
}

#[test]
fn splishsplash_frames_match_the_values_of_their_simulation() {
    let frames = [
        (
            1,
            [
                [-1.9000000953674316, 0.09996075928211212, -0.44999998807907104],
                [-1.0000001192092896, 1.2499607801437378, 0.45000001788139343],
            ],
            0.019620001316070557,
        ),
        (
            10,
            [
                [-1.9498687982559204, 0.0397249311208725, -0.7047143578529358],
                [-0.18260399997234344, 1.037776231765747, 0.704704761505127],
            ],
            7.032591819763184,
        ),
        (
            20,
            [
                [-1.9468082189559937, 0.03871124982833862, -0.7047089338302612],
                [1.645922303199768, 2.7653231620788574, 0.704710841178894],
            ],
            6.232513427734375,
        ),
    ];
    for (number, expected_bounds, fastest) in frames {
        let file =
            open_particles(&data(&format!("dambreak_small/ParticleData_Fluid_{number}.bgeo")))
                .unwrap();
        assert_eq!(file.particles.len(), 8664);
        assert_eq!(bounds(&positions(&file)), expected_bounds, "frame {number}");
        assert_eq!(attributes(&file), [("id", 1), ("velocity", 3), ("density", 1)]);
        assert_eq!(velocity_attribute(file.particles.attributes()), Some(1));
        let speeds = attribute(&file, "velocity");
        let speeds =
            speeds.chunks(3).map(|v| v.iter().map(|&x| f64::from(x).powi(2)).sum::<f64>().sqrt());
        assert!((speeds.fold(0.0, f64::max) - fastest).abs() < 1e-6, "frame {number}");
        let mut ids = attribute(&file, "id");
        ids.sort_by(f32::total_cmp);
        assert!(ids.iter().enumerate().all(|(i, &id)| i as f32 == id), "each id must occur once");
    }
}

/// The expected values come from a separate program. It found the arrays by their tags, and
/// selected the rows whose Idp is at least CaseNfixed + CaseNmoving + CaseNfloat = 7846.
#[test]
fn a_dualsphysics_part_gives_its_fluid_particles_and_spacing() {
    let file = open_particles(&data("dualsphysics_dambreak/Part_0005.bi4")).unwrap();
    assert_eq!(file.spacing, Some(0.02));
    assert_eq!(attributes(&file), [("Idp", 1), ("Vel", 3), ("Rhop", 1)]);
    let positions = positions(&file);
    assert_eq!(positions.len(), 9600);
    assert_eq!(
        bounds(&positions),
        [
            [0.028087908402085304, 0.02641223929822445, 0.025894498452544212],
            [1.3392283916473389, 0.6535863280296326, 0.19753335416316986]
        ]
    );
    assert_eq!(positions[1234], [0.12831753492355347, 0.25041982531547546, 0.039033424109220505]);
    assert_eq!(attribute(&file, "Idp")[1234], 9452.0);
    assert_eq!(
        attribute(&file, "Vel")[3 * 1234..][..3],
        [0.179_336_86, 0.003_737_534_4, -0.018_744_586]
    );
    assert_eq!(attribute(&file, "Rhop")[1234], 999.602_84);
}

#[test]
fn every_binary_layout_is_read_exactly_compressed_or_not() {
    let folder = tempfile::tempdir().unwrap();
    for (number, (name, _, bytes)) in samples().into_iter().chain(encoded_samples()).enumerate() {
        let plain = folder.path().join(format!("{number}.{name}"));
        std::fs::write(&plain, &bytes).unwrap();
        let mut paths = vec![plain];
        for (extension, pack) in PACKERS {
            let packed = format!("{number}.{}.{}", name.to_uppercase(), extension.to_uppercase());
            let misnamed = format!("{number}-{extension}.{name}");
            for path in [packed, misnamed].map(|name| folder.path().join(name)) {
                std::fs::write(&path, pack(&bytes)).unwrap();
                paths.push(path);
            }
        }
        for path in paths {
            let file = open_particles(&path).unwrap();
            assert_eq!(positions(&file), tuples(7), "{}", path.display());
        }
    }
}

#[test]
fn every_range_of_particles_equals_that_of_the_whole_file() {
    for (name, reader, bytes) in samples().into_iter().chain(encoded_samples()) {
        let file = read(reader, &bytes).unwrap();
        let whole = positions(&file);
        for first in 0..=whole.len() {
            for count in 0..=whole.len() - first {
                let mut part = vec![[0.0; 3]; count];
                file.particles.positions(first, &mut part);
                assert_eq!(part, whole[first..first + count], "{name} {first} {count}");
            }
        }
    }
}

#[test]
fn a_bgeo_gives_float_vector_and_integer_attributes_and_strings_as_labels() {
    let file = read(bgeo::read_particles, &build::bgeo(&tuples(7))).unwrap();
    assert_eq!(attributes(&file), [("id", 1), ("v", 3), ("uv", 2)]);
    assert_eq!(attribute(&file, "id"), [-1.0, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0]);
    let v: Vec<f32> = (0..7).flat_map(|i| [0.5, 1.5, 2.5].map(|x| x + i as f32)).collect();
    assert_eq!(attribute(&file, "v"), v);
    let uv: Vec<f32> = (0..7).flat_map(|i| [0.25, 0.75].map(|x| x + i as f32)).collect();
    assert_eq!(attribute(&file, "uv"), uv);
    let texts = ["", "", "water", "", "", "", "water"];
    let label = &file.particles.labels()[0];
    let mut found = [0; 7];
    file.particles.label(0, 0, &mut found);
    assert_eq!((&*label.name, found.map(|text| &*label.texts[text as usize])), ("group", texts));
}

#[test]
fn a_bi4_gives_only_fluid_particles_in_any_order() {
    for mixed in [false, true] {
        let layout = Bi4 { big: false, wide: false, double: false, mixed, pieces: 1, piece: 0 };
        let file = read(bi4::read_particles, &layout.build(&tuples(7))).unwrap();
        assert_eq!(file.spacing, Some(0.25));
        assert_eq!(attributes(&file), [("Idp", 1), ("Vel", 3)]);
        assert_eq!(attribute(&file, "Idp"), [5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0]);
        let velocity: Vec<f32> = tuples(7).as_flattened().iter().map(|&x| 2.0 * x as f32).collect();
        assert_eq!(attribute(&file, "Vel"), velocity);
    }
}

#[test]
fn files_without_particles_are_read() {
    let layout = Bi4 { big: false, wide: false, double: false, mixed: false, pieces: 1, piece: 0 };
    let empty: [(Reader, Vec<u8>); 5] = [
        (bgeo::read_particles, build::bgeo(&[])),
        (NPY, build::npy(&[], "<f4", false)),
        (NPY, build::npy(&[], "<f4", true)),
        (bi4::read_particles, layout.build(&[])),
        (TEXT, b"# nobody here\n\n".to_vec()),
    ];
    for (reader, bytes) in empty {
        assert!(read(reader, &bytes).unwrap().particles.is_empty());
    }
    let named = text("x,y,z,vx,vy,vz\n").unwrap();
    assert_eq!((named.particles.len(), attributes(&named)), (0, vec![("v", 3)]));
}

#[test]
fn a_truncated_file_is_refused_at_every_length() {
    for (name, reader, bytes) in samples() {
        for end in 0..bytes.len() {
            match read(reader, &bytes[..end]) {
                Err(ReadFault::Truncated { needed, have, .. }) => {
                    assert!(have == end as u64 && needed > have, "{name} cut at {end}");
                }
                Err(ReadFault::Malformed { .. }) if name == "raw.xyz" => assert_ne!(end % 12, 0),
                Err(other) => panic!("{name} cut at {end}: {other}"),
                Ok(_) => assert!(name == "raw.xyz" && end % 12 == 0, "{name} cut at {end} is read"),
            }
        }
    }
}

#[test]
fn a_truncated_file_of_encoded_numbers_is_refused_at_every_length() {
    for (name, reader, bytes) in encoded_samples() {
        for end in 0..bytes.trim_ascii_end().len() {
            assert!(read(reader, &bytes[..end]).is_err(), "{name} cut at {end} of {}", bytes.len());
        }
    }
}

/// The result of a reader, as text: all numbers, or the error.
fn outcome(file: Result<ParticleFile, ReadFault>) -> String {
    let numbers = |file: ParticleFile| {
        let values: Vec<_> =
            attributes(&file).iter().map(|(name, _)| attribute(&file, name)).collect();
        format!("{:?} {values:?}", positions(&file))
    };
    file.map_or_else(|fault| fault.to_string(), numbers)
}

#[test]
fn reading_by_position_equals_reading_from_memory_at_every_length() {
    let folder = tempfile::tempdir().unwrap();
    for (number, (name, reader, bytes)) in
        samples().into_iter().chain(encoded_samples()).enumerate()
    {
        // Begin with two bytes, because a file with a single byte is read into memory.
        for cut in 2..=bytes.len() {
            let path = folder.path().join(format!("{number}.{cut}"));
            std::fs::write(&path, &bytes[..cut]).unwrap();
            let opened = open_bytes(&path).unwrap();
            assert!(matches!(opened, Bytes::File(_)), "{name}");
            let [by_position, in_memory] =
                [reader(opened), read(reader, &bytes[..cut])].map(outcome);
            assert_eq!(by_position, in_memory, "{name} of {cut} bytes");
        }
    }
}

#[test]
fn bi4_headers_between_large_arrays_are_read_by_position() {
    let points = tuples(40000);
    let mut written = tempfile::NamedTempFile::new().unwrap();
    for mixed in [false, true] {
        let layout = Bi4 { big: false, wide: true, double: mixed, mixed, pieces: 1, piece: 0 };
        let bytes = layout.build(&points);
        written.as_file_mut().set_len(0).unwrap();
        written.rewind().unwrap();
        written.write_all(&bytes).unwrap();
        let opened = open_bytes(written.path()).unwrap();
        let [by_position, in_memory] =
            [bi4::read_particles(opened), read(bi4::read_particles, &bytes)];
        let by_position = by_position.unwrap();
        assert!(by_position.particles.len() > 32768, "the file fits in one chunk");
        assert!(outcome(Ok(by_position)) == outcome(in_memory), "mixed {mixed}");
    }
}

#[test]
fn a_file_truncated_after_opening_is_reported_as_changed() {
    let folder = tempfile::tempdir().unwrap();
    for (number, (name, reader, bytes)) in
        samples().into_iter().chain(encoded_samples()).enumerate()
    {
        for left in (1..bytes.len()).step_by(11) {
            let path = folder.path().join(format!("{number}.{left}"));
            std::fs::write(&path, &bytes).unwrap();
            let opened = open_bytes(&path).unwrap();
            let file = std::fs::OpenOptions::new().write(true).open(&path).unwrap();
            file.set_len(left as u64).unwrap();
            match reader(opened) {
                Err(ReadFault::Changed) => {}
                // Opening a file does not read all columns, so `check` must find the truncation.
                Ok(file) => assert_eq!(file.particles.check(), Err(RereadError::Changed), "{name}"),
                Err(fault) => panic!("{name}: {fault}"),
            }
        }
    }
}

#[test]
fn a_flipped_bit_in_checksummed_positions_is_detected() {
    let points = tuples(7);
    let mut files: Vec<(Reader, Vec<u8>)> = Vec::new();
    // Leave out LZ4, whose blocks have no checksum.
    let compressed = |layout: &VtkXml| {
        matches!(layout.compressor, Compressor::Zlib | Compressor::Lzma)
            && layout.placed != Placed::Ascii
    };
    files.extend(
        VtkXml::all().into_iter().filter(compressed).map(|layout| (VTU, layout.build(&points))),
    );
    for compression in [CompressionMethod::Stored, CompressionMethod::Deflated] {
        files.push((NPZ, build::npz(&[("pos", build::npy(&points, "<f4", true))], compression)));
    }
    for (reader, bytes) in files {
        for at in 0..bytes.len() {
            let mut damaged = bytes.clone();
            damaged[at] ^= 0x10;
            if let Ok(file) = read(reader, &damaged)
                && !file.particles.is_empty()
            {
                assert_eq!(
                    positions(&file),
                    points,
                    "byte {at} of {}: {}",
                    bytes.len(),
                    file.format
                );
            }
        }
    }
}

#[test]
fn vtk_xml_and_npz_give_attributes_and_time_in_every_encoding() {
    let doubled: Vec<f32> = tuples(7).as_flattened().iter().map(|&x| 2.0 * x as f32).collect();
    for (name, reader, bytes) in encoded_samples() {
        let file = read(reader, &bytes).unwrap();
        let (velocity, time) = if name == "vtu" { ("velocity", Some(1.5)) } else { ("vel", None) };
        assert_eq!(
            (attributes(&file), file.time),
            (vec![(velocity, 3), ("id", 1)], time),
            "{name}"
        );
        assert_eq!(attribute(&file, velocity), doubled, "{name}");
        assert_eq!(attribute(&file, "id"), [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0], "{name}");
    }
}

#[test]
fn legacy_and_xml_vtk_files_take_the_time_from_the_same_fields() {
    let legacy = |fields: &[(&str, &str)]| {
        let field = |(name, values): &(&str, &str)| {
            format!("{name} 1 {} double\n{values}\n", values.split(' ').count())
        };
        format!(
            "# vtk DataFile Version 3.0\nt\nASCII\nDATASET POLYDATA\nFIELD FieldData {}\n{}\
             POINTS 1 float\n1 2 3\n",
            fields.len(),
            fields.iter().map(field).collect::<String>()
        )
    };
    let xml = |fields: &[(&str, &str)]| {
        let field = |(name, values): &(&str, &str)| {
            format!(
                "<DataArray type=\"Float64\" Name=\"{name}\" NumberOfTuples=\"{}\" \
                 format=\"ascii\">{values}</DataArray>",
                values.split(' ').count()
            )
        };
        format!(
            "<VTKFile type=\"UnstructuredGrid\"><UnstructuredGrid><FieldData>{}</FieldData>\
             <Piece NumberOfPoints=\"1\"><Points><DataArray type=\"Float32\" \
             NumberOfComponents=\"3\">1 2 3</DataArray></Points></Piece></UnstructuredGrid>\
             </VTKFile>",
            fields.iter().map(field).collect::<String>()
        )
    };
    type Fields = &'static [(&'static str, &'static str)];
    let cases: [(Fields, Option<f64>); 8] = [
        (&[("time", "0.5")], Some(0.5)),
        (&[("t", "0.25")], Some(0.25)),
        (&[("mass", "2")], None),
        (&[("time", "1 2")], None),
        // The order of the fields does not matter: the reader takes the field with the preferred
        // name.
        (&[("time", "1"), ("TimeValue", "0.5")], Some(0.5)),
        (&[("TimeValue", "0.5"), ("time", "1")], Some(0.5)),
        (&[("TIME", "3"), ("Time", "2"), ("t", "1")], Some(2.0)),
        (&[("TimeValue", "1 2"), ("time", "0.5")], Some(0.5)),
    ];
    for (fields, time) in cases {
        for (reader, text) in [(VTK, legacy(fields)), (VTU, xml(fields))] {
            assert_eq!(read(reader, text.as_bytes()).unwrap().time, time, "{text}");
        }
    }
    let declared = xml(&[("time", "1 2")]);
    let undeclared = declared.replace(" NumberOfTuples=\"2\"", "");
    assert_ne!(undeclared, declared);
    assert_eq!(read(VTU, undeclared.as_bytes()).unwrap().time, None, "two numbers are not a time");
}

#[test]
fn encoded_numbers_beyond_the_memory_limit_are_decoded_to_scratch_files() {
    let scratch = tempfile::tempdir().unwrap();
    let unpacking = Unpacking { in_memory: 100, scratch: scratch.path(), control: None };
    let folder = tempfile::tempdir().unwrap();
    let mut scratched = 0;
    for (name, reader, bytes) in encoded_samples() {
        let path = folder.path().join(format!("a.{name}"));
        std::fs::write(&path, &bytes).unwrap();
        let file = input::open_particles(&path, unpacking).unwrap();
        assert_eq!(positions(&file), positions(&read(reader, &bytes).unwrap()));
        scratched += usize::from(file.particles.scratch_bytes() > 0);
    }
    // All files were unpacked to scratch files, except those that are read in place.
    assert_eq!(scratched, 32 + 12 - 4 + 1);
    let nowhere = Unpacking { in_memory: 100, scratch: Path::new("nowhere"), control: None };
    let path = folder.path().join("a.npz");
    let fault = input::open_particles(&path, nowhere).expect_err("refused").fault;
    assert!(matches!(fault, ReadFault::Scratch(_)), "{fault}");
}

#[test]
fn npz_positions_are_found_by_name_or_as_the_only_candidate() {
    let points = tuples(4);
    let vectors = build::npy(&points, "<f4", false);
    let axis = |axis: usize| {
        let column = points.iter().flat_map(|p| p[axis].to_le_bytes());
        build::npy_header("<f8", false, "(4,)").into_iter().chain(column).collect::<Vec<u8>>()
    };
    let pairs = [build::npy_header("<i8", false, "(4, 2)"), vec![1; 64]].concat();
    let [x, y, z] = [axis(0), axis(1), axis(2)];
    type Case = (Vec<(&'static str, Vec<u8>)>, Vec<(&'static str, usize)>);
    let cases: Vec<Case> = vec![
        (vec![("v", vectors.clone()), ("x", vectors.clone())], vec![("v", 3)]),
        (vec![("v", vectors.clone()), ("Positions", vectors.clone())], vec![("v", 3)]),
        (vec![("arr_0", vectors.clone())], vec![]),
        (
            vec![("mass", x.clone()), ("arr_0", vectors.clone()), ("pair", pairs)],
            vec![("mass", 1), ("pair", 2)],
        ),
        (vec![("z", z), ("y", y), ("x", x), ("v", vectors.clone())], vec![("v", 3)]),
    ];
    for (arrays, expected) in cases {
        let names: Vec<_> = arrays.iter().map(|(name, _)| *name).collect();
        for compression in [CompressionMethod::Stored, CompressionMethod::Deflated] {
            let file = read(NPZ, &build::npz(&arrays, compression)).unwrap();
            assert_eq!(
                (positions(&file), attributes(&file)),
                (points.clone(), expected.clone()),
                "{names:?}"
            );
        }
    }
    let neither = build::npz(&[("a", vectors.clone()), ("b", vectors)], CompressionMethod::Stored);
    let fault = fault(read(NPZ, &neither));
    assert!(
        fault.contains("save one as pos, with shape (N") && fault.contains("a (4, 3), b (4, 3)"),
        "{fault}"
    );
}

#[test]
fn numpy_arrays_of_another_shape_lead_to_advice_that_keeps_all_particles() {
    let array = |sizes: &[usize]| {
        let shape: String = sizes.iter().map(|size| format!("{size},")).collect();
        let bytes = 8 * sizes.iter().product::<usize>();
        [build::npy_header("<f8", false, &format!("({shape})")), vec![0; bytes]].concat()
    };
    for (sizes, advice) in [
        (&[50, 2][..], "np.pad(a, ((0, 0), (0, 1)))"),
        (&[2, 50], "np.pad(a, ((0, 1), (0, 0)))"),
        (&[5, 50, 2], "np.pad(a, ((0, 0), (0, 0), (0, 1)))"),
        (&[50, 6], "a[:, :3]"),
        (&[6, 50], "a[:3]"),
        (&[5, 50, 6], "a[:, :, :3]"),
        (&[5, 3, 50], "a.transpose(0, 2, 1)"),
        (&[150], "a.reshape(-1, 3)"),
        (&[151], "an array of that shape"),
        (&[1, 50], "an array of that shape"),
        (&[50, 1], "an array of that shape"),
    ] {
        let fault = fault(read(NPY, &array(sizes)));
        assert!(fault.ends_with(advice), "{sizes:?}: {fault}");
    }
    let archive = |arrays: &[(&str, &[usize])]| {
        let arrays: Vec<_> = arrays.iter().map(|(name, sizes)| (*name, array(sizes))).collect();
        fault(read(NPZ, &build::npz(&arrays, CompressionMethod::Stored)))
    };
    for (arrays, advice) in [
        (&[("pos", &[50, 2][..]), ("m", &[50])][..], "np.pad(pos, ((0, 0), (0, 1)))"),
        (&[("arr_0", &[2, 50])], "np.pad(arr_0, ((0, 1), (0, 0)))"),
        (&[("x", &[50]), ("y", &[50])], "np.zeros_like(y)"),
    ] {
        let fault = archive(arrays);
        assert!(fault.ends_with(advice), "{fault}");
    }
    assert!(!archive(&[("vel", &[50, 2])]).contains("zeros"));
}

#[test]
fn velocities_are_recognised_by_names_like_those_of_positions() {
    let points = tuples(4);
    let vectors = || build::npy(&points, "<f4", false);
    for (position, velocity) in [
        ("particle_position", "particle_velocity"),
        ("particle_q", "particle_qd"),
        ("x_p", "v_p"),
        ("xp", "vp"),
        ("p_pos", "p_vel"),
        ("pos", "vels"),
        ("POS", "VEL"),
        ("pos", "particle velocity"),
        ("pos", "fluid_velocity"),
        ("pos", "U"),
    ] {
        let arrays = [(position, vectors()), (velocity, vectors())];
        let file = read(NPZ, &build::npz(&arrays, CompressionMethod::Stored)).unwrap();
        let infos = file.particles.attributes();
        let found = velocity_attribute(infos).map(|index| &*infos[index].name);
        assert_eq!((positions(&file), found), (points.clone(), Some(velocity)));
    }
    let arrays = [("pos [m]", vectors()), ("velocity [m/s]", vectors())];
    let file = read(NPZ, &build::npz(&arrays, CompressionMethod::Stored)).unwrap();
    assert_eq!((positions(&file), attributes(&file)), (points.clone(), vec![("velocity", 3)]));
}

#[test]
fn names_that_differ_only_in_what_follows_in_brackets_stay_apart() {
    let other = || build::npy(&tuples(5)[1..], "<f4", false);
    let own = || build::npy(&tuples(4), "<f4", false);
    let archive = |arrays: &[(&str, Vec<u8>)]| {
        read(NPZ, &build::npz(arrays, CompressionMethod::Stored)).unwrap()
    };
    let file = archive(&[("pos (initial)", other()), ("pos", own())]);
    assert_eq!(positions(&file), tuples(4));
    let file = archive(&[("vel (avg)", other()), ("vel", own()), ("pos", own())]);
    let velocity = velocity_attribute(file.particles.attributes()).unwrap();
    assert_eq!(attributes(&file)[velocity], ("vel", 3));
    let single: Vec<f32> = tuples(4).as_flattened().iter().map(|&x| x as f32).collect();
    assert_eq!(attribute(&file, "vel"), single);
}

#[test]
fn separate_components_of_a_velocity_in_vtk_xml_are_also_a_vector() {
    let array = |name: &str, components: usize, values: &str| {
        format!(
            "<DataArray type=\"Float32\" Name=\"{name}\" NumberOfComponents=\"{components}\" \
             format=\"ascii\">{values}</DataArray>"
        )
    };
    let arrays = [("vz", "5 6"), ("rho", "7 8"), ("vx", "1 2"), ("vy", "3 4")];
    let arrays = arrays.map(|(name, values)| array(name, 1, values)).concat();
    let text = format!(
        "<VTKFile type=\"PolyData\" version=\"1.0\" byte_order=\"LittleEndian\"><PolyData>\
         <Piece NumberOfPoints=\"2\"><PointData>{arrays}</PointData><Points>{}</Points></Piece>\
         </PolyData></VTKFile>",
        array("Points", 3, "0 0 0 1 1 1")
    );
    let file = read(VTU, text.as_bytes()).unwrap();
    let expected = [("vz", 1), ("rho", 1), ("vx", 1), ("vy", 1), ("velocity", 3)];
    assert_eq!(attributes(&file), expected);
    assert_eq!(attribute(&file, "velocity"), [1.0, 3.0, 5.0, 2.0, 4.0, 6.0]);
    // `U` can be a displacement, so the velocity is joined from vx, vy and vz.
    let text = text.replace("<PointData>", &format!("<PointData>{}", array("U", 3, "9 9 9 9 9 9")));
    let file = read(VTU, text.as_bytes()).unwrap();
    let velocity = velocity_attribute(file.particles.attributes()).unwrap();
    assert_eq!(attributes(&file)[velocity], ("velocity", 3));
}

#[test]
fn a_byte_order_mark_before_vtk_xml_is_skipped() {
    for layout in VtkXml::all() {
        let points = tuples(5);
        let marked = [b"\xef\xbb\xbf", &layout.build(&points)[..]].concat();
        let file = VTU(marked.into()).unwrap();
        assert_eq!(positions(&file), points, "{layout:?}");
        assert_eq!(file.time, Some(1.5));
    }
}

#[test]
fn vtk_xml_lengths_of_8_bytes_need_no_declaration_if_only_they_fit() {
    for points in [tuples(5), vec![[0.0; 3]; 5]] {
        for layout in VtkXml::all().into_iter().filter(|l| !l.is_compressed()) {
            let mut bytes = layout.build(&points);
            if layout.wide {
                let at = bytes.windows(6).position(|word| word == b"UInt64").unwrap();
                bytes[at..at + 6].copy_from_slice(b"UInt32");
            }
            let file = VTU(bytes.into());
            match (layout.placed, layout.wide) {
                (Placed::AppendedBase64, true) => {}
                (Placed::Base64, true) => {
                    let fault = file.expect_err("refused").to_string();
                    assert!(layout.big || fault.contains("header_type=\"UInt64\""), "{fault}");
                }
                _ => {
                    let file = file.unwrap();
                    assert_eq!(positions(&file), points, "{layout:?}");
                    assert_eq!(attribute(&file, "id"), [0.0, 1.0, 2.0, 3.0, 4.0]);
                }
            }
        }
    }
}

#[test]
fn npz_positions_are_preferred_to_coordinates_and_grid_axes() {
    let (points, axis) = (tuples(4), |count: usize| {
        let numbers = (0..count).flat_map(|i| (i as f64).to_le_bytes()).collect();
        [build::npy_header("<f8", false, &format!("({count},)")), numbers].concat()
    });
    let of = |count, position| {
        let names = ["x", "y", "z"].map(|name| (name, axis(count)));
        let arrays = [&names[..], &[position]].concat();
        read(NPZ, &build::npz(&arrays, CompressionMethod::Stored)).unwrap()
    };
    let file = of(9, ("Position", build::npy(&points, "<f4", false)));
    assert_eq!((positions(&file), attributes(&file)), (points.clone(), vec![]));
    let left_out = r#"arrays "x", "y" and "z", because "Position" contains the positions"#;
    assert_eq!(file.left_out[0].to_string(), left_out);
    let file = of(4, ("pos", build::npy(&points, "<f4", false)));
    assert_eq!((positions(&file), attributes(&file)), (points, vec![("xyz", 3)]));
    assert_eq!(attribute(&file, "xyz")[3..6], [1.0; 3]);
    let frames = build::npy(&tuples(4), "<f8", false);
    let frames = ["x", "y", "z"].map(|name| (name, frames.clone()));
    let fault = fault(read(NPZ, &build::npz(&frames, CompressionMethod::Stored)));
    assert!(fault.contains("x (4, 3), y (4, 3), z (4, 3)"), "{fault}");
}

#[test]
fn npz_frames_have_the_times_of_an_array_of_that_length() {
    let points = tuples(6);
    let doubles = |shape: &str, values: &[f64]| {
        let bytes = values.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<_>>();
        [build::npy_header("<f8", false, shape), bytes].concat()
    };
    let frames = doubles("(2, 3, 3)", points.as_flattened());
    let single = build::npy(&points, "<f8", false);
    let whole = |times: [i16; 2]| {
        let bytes = times.iter().flat_map(|x| x.to_be_bytes()).collect::<Vec<_>>();
        [build::npy_header(">i2", false, "(2,)"), bytes].concat()
    };
    for compression in [CompressionMethod::Stored, CompressionMethod::Deflated] {
        let time = |pos: &Vec<u8>, step, name: &str, times: Vec<u8>| {
            let archive = build::npz(&[("pos", pos.clone()), (name, times)], compression);
            let file = npz::read_particles(archive.into(), step, Unpacking::in_memory()).unwrap();
            assert!(attributes(&file).is_empty() && file.left_out.is_empty(), "{name}");
            file.time
        };
        for (step, expected) in [(0, 0.25), (1, -4.0)] {
            let step = Some(step);
            let of_frames = |name, times| time(&frames, step, name, times);
            assert_eq!(of_frames("time", doubles("(2,)", &[0.25, -4.0])), Some(expected));
            // Integers usually count steps, so they are not read as times.
            assert_eq!(of_frames("times", whole([1, -16])), None);
            assert_eq!(of_frames("time", doubles("(4,)", &[0.25, -4.0, 7.0, 8.0])), None);
            assert_eq!(of_frames("speeds", doubles("(2,)", &[0.25, -4.0])), None);
            assert_eq!(of_frames("t", doubles("(2,)", &[f64::NAN; 2])), None);
        }
        for (shape, values, expected) in [
            ("()", &[0.5][..], Some(0.5)),
            ("(1,)", &[0.5], Some(0.5)),
            ("(1, 1)", &[0.5], Some(0.5)),
            ("(2,)", &[0.5, 1.0], None),
        ] {
            let found = time(&single, None, "time", doubles(shape, values));
            assert_eq!(found, expected, "{shape}");
        }
    }
}

#[test]
fn npz_arrays_that_do_not_match_the_particles_are_named() {
    let points = tuples(6);
    let bytes = points.as_flattened().iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<_>>();
    let frames = [build::npy_header("<f8", false, "(3, 2, 3)"), bytes].concat();
    let vel = build::npy(&tuples(5), "<f4", false);
    let part = |particles, frames| {
        let (name, shape) = ("vel".to_owned(), vec![5, 3]);
        vec![UnreadPart::OtherShape { name, shape, particles, frames }]
    };
    for (pos, step, expected) in [
        (build::npy(&points, "<f8", false), None, part(6, None)),
        (frames, Some(1), part(2, Some(3))),
    ] {
        let archive = build::npz(&[("pos", pos), ("vel", vel.clone())], CompressionMethod::Stored);
        let file = npz::read_particles(archive.into(), step, Unpacking::in_memory()).unwrap();
        assert_eq!(file.left_out, expected);
    }
}

#[test]
fn numpy_arrays_may_contain_frames_or_have_components_first() {
    let points = tuples(6);
    let numbers = |values: &[f64]| values.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<_>>();
    let array = |shape: &str, values: &[f64]| {
        [build::npy_header("<f8", false, shape), numbers(values)].concat()
    };
    let of = |points: &[[f64; 3]]| points.as_flattened().to_vec();
    let frames = array("(2, 3, 3)", &of(&points));
    for (step, expected) in [(0, &points[..3]), (1, &points[3..])] {
        let npy = npy::read_particles(frames.clone().into(), Some(step)).unwrap();
        assert_eq!(positions(&npy), expected);
        let numbers = build::npz(
            &[("pos", frames.clone()), ("mass", array("(3,)", &[1.0, 2.0, 3.0]))],
            CompressionMethod::Deflated,
        );
        let npz = npz::read_particles(numbers.into(), Some(step), Unpacking::in_memory()).unwrap();
        assert_eq!((positions(&npz), attributes(&npz)), (expected.to_vec(), vec![("mass", 1)]));
        assert_eq!((npz.time, npz.left_out), (None, vec![]));
    }
    for step in [None, Some(2)] {
        let fault = npy::read_particles(frames.clone().into(), step).unwrap_err();
        assert!(matches!(fault, ReadFault::Unsupported(_)), "{fault}");
    }
    let apart: Vec<f64> = (0..3).flat_map(|axis| points.iter().map(move |p| p[axis])).collect();
    assert_eq!(positions(&read(NPY, &array("(3, 6)", &apart)).unwrap()), points);
    assert_eq!(positions(&read(NPY, &array("(1, 6, 3)", &of(&points))).unwrap()), points);
}

#[test]
fn fields_of_a_structured_numpy_array_become_attributes() {
    let header = build::npy_header("<f4", false, "(2,)");
    let header = String::from_utf8_lossy(&header[10..]).into_owned();
    let kinds = "[('id', '<u2'), ('pos', '>f4', (3,)), ('name', '|S2'), ('v', '<f8')]";
    let text = header.replace("'<f4'", kinds);
    let length = (text.len() as u16).to_le_bytes();
    let mut bytes = [b"\x93NUMPY\x01\x00", &length[..], text.as_bytes()].concat();
    for row in [1.0f32, 2.0] {
        bytes.extend((row as u16).to_le_bytes());
        [row, 3.0, 4.0].iter().for_each(|x| bytes.extend(x.to_be_bytes()));
        bytes.extend(b"ab");
        bytes.extend(f64::from(10.0 * row).to_le_bytes());
    }
    for (reader, bytes) in [
        (NPY, bytes.clone()),
        (NPZ, build::npz(&[("table", bytes.clone())], CompressionMethod::Stored)),
    ] {
        let file = read(reader, &bytes).unwrap();
        assert_eq!(positions(&file), [[1.0, 3.0, 4.0], [2.0, 3.0, 4.0]]);
        assert_eq!(attributes(&file), [("id", 1), ("v", 1)]);
        assert_eq!(attribute(&file, "v"), [10.0, 20.0]);
    }
    let text = text.replace("'id'", "'x'").replace("'v'", "'y'").replace("'|S2'", "'<i2'");
    let text = text.replace("'name'", "'z'").replace('}', "}    ");
    let coordinates = [&bytes[..8], &length[..], text.as_bytes(), &bytes[10 + text.len()..]];
    let file = read(NPY, &coordinates.concat()).unwrap();
    assert_eq!(positions(&file), [[1.0, 3.0, 4.0], [2.0, 3.0, 4.0]]);
    assert_eq!(attributes(&file), [("xyz", 3)]);
    let two = build::npz(&[("a", bytes.clone()), ("b", bytes)], CompressionMethod::Stored);
    assert!(matches!(read(NPZ, &two), Err(ReadFault::Unsupported(_))));
}

#[test]
fn a_bi4_part_is_read_completely_from_any_of_its_pieces() {
    let folder = tempfile::tempdir().unwrap();
    let points = tuples(9);
    let layout = |piece: u32| Bi4 {
        big: false,
        wide: false,
        double: false,
        mixed: piece == 1,
        pieces: 3,
        piece,
    };
    let path = |piece: u32| folder.path().join(format!("Part_p{piece:02}_0007.bi4"));
    for (piece, points) in (0..).zip(points.chunks(3)) {
        std::fs::write(path(piece), layout(piece).build(points)).unwrap();
    }
    for piece in 0..3 {
        assert_eq!(bi4::is_later_piece(&path(piece)), piece > 0);
        let file = open_particles(&path(piece)).unwrap();
        assert_eq!(
            (positions(&file), file.spacing, file.time),
            (points.clone(), Some(0.25), Some(1.5))
        );
        assert_eq!(attributes(&file), [("Idp", 1), ("Vel", 3)]);
        assert_eq!(attribute(&file, "Idp"), [5.0, 6.0, 7.0].repeat(3));
    }
    for (piece, bytes, expected) in [
        (1, layout(1).build(&points)[..500].to_vec(), "truncated"),
        (2, layout(1).build(&points), "expected piece 2 of 3, found piece 1 of 3"),
        (
            2,
            Bi4 { double: true, ..layout(2) }.build(&points),
            "an attribute Idpd (components: 1), unlike earlier pieces",
        ),
    ] {
        let right = std::fs::read(path(piece)).unwrap();
        std::fs::write(path(piece), bytes).unwrap();
        let error = open_particles(&path(0)).expect_err(expected);
        assert_eq!(error.path, path(piece));
        assert!(error.to_string().contains(expected), "{error}");
        std::fs::write(path(piece), right).unwrap();
    }
    // Each piece is read in its own byte order.
    std::fs::write(path(1), Bi4 { big: true, ..layout(1) }.build(&points[3..6])).unwrap();
    assert_eq!(positions(&open_particles(&path(0)).unwrap()), points);
    std::fs::remove_file(path(1)).unwrap();
    let error = open_particles(&path(2)).expect_err("missing");
    assert!(error.path == path(1) && matches!(error.fault, ReadFault::Io(_)), "{error}");
    let alone = folder.path().join("alone.bi4");
    std::fs::rename(path(2), &alone).unwrap();
    let fault = open_particles(&alone).expect_err("unnamed").to_string();
    assert!(fault.contains("Part_p00_0000.bi4"), "{fault}");
}

#[test]
fn damaged_compressed_files_are_detected() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("frame.bgeo");
    for (extension, pack) in PACKERS {
        let packed = pack(&build::bgeo(&tuples(7)));
        for end in 6..packed.len() {
            std::fs::write(&path, &packed[..end]).unwrap();
            let fault = open_particles(&path).expect_err("refused").fault;
            assert!(matches!(fault, ReadFault::Compression(_)), "{extension} at {end}: {fault}");
        }
        for at in 0..packed.len() {
            for flip in [0x01, 0x80, 0xff] {
                let mut damaged = packed.clone();
                damaged[at] ^= flip;
                std::fs::write(&path, damaged).unwrap();
                // These zstd files have no checksum, so damage may change numbers without an error.
                if let Ok(file) = open_particles(&path)
                    && extension != "zst"
                {
                    assert_eq!(positions(&file), tuples(7), "{extension} at {at}");
                }
            }
        }
    }
}

#[test]
fn concatenated_compressed_streams_are_read_as_one_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("frame.xyz");
    let [one, two] =
        [7, 5].map(|count| build::raw(&(0..count).map(|i| [f64::from(i); 3]).collect::<Vec<_>>()));
    for (extension, pack) in PACKERS {
        for (parts, count) in
            [(vec![&one, &two], 12), (vec![&one, &one], 14), (vec![&one, &two, &one], 19)]
        {
            std::fs::write(&path, parts.iter().flat_map(|part| pack(part)).collect::<Vec<u8>>())
                .unwrap();
            assert_eq!(open_particles(&path).unwrap().particles.len(), count, "{extension}");
        }
        // Bytes that follow a stream but do not form another stream give an error.
        let begun = &pack(&two)[..4];
        std::fs::write(&path, [&pack(&one), begun, b"rest"].concat()).unwrap();
        let fault = open_particles(&path).expect_err("refused").fault;
        assert!(matches!(fault, ReadFault::Compression(_)), "{extension}: {fault}");
    }
}

#[test]
fn a_decompression_bomb_is_refused_before_it_fills_the_memory() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bomb.xyz");
    for (extension, pack) in PACKERS {
        let of_64_mib = memory::unlimited(|| pack(&vec![0; 64 << 20]));
        std::fs::write(&path, of_64_mib.repeat(8)).unwrap();
        let (result, largest) = memory::largest_allocation(|| open_particles(&path));
        let fault = result.expect_err("refused").fault;
        assert!(matches!(fault, ReadFault::Compression(_)), "{extension}: {fault}");
        assert!(largest <= 256 << 20, "{extension}: {largest} bytes");
    }
}

#[test]
fn counts_beyond_the_file_size_are_refused_without_allocating() {
    let points = tuples(7);
    let most = i32::MAX.to_be_bytes();
    let mut cases: Vec<(Reader, Vec<u8>)> = Vec::new();
    for count_at in [9, 25] {
        let mut bytes = build::bgeo(&points);
        bytes[count_at..count_at + 4].copy_from_slice(&most);
        cases.push((bgeo::read_particles, bytes));
    }
    for rows in [1 << 31, 1 << 63, u64::MAX] {
        for fortran in [false, true] {
            cases.push((NPY, build::npy_header("<f8", fortran, &format!("({rows}, 3)"))));
        }
    }
    for wide in [false, true] {
        let bytes = Bi4 { big: true, wide, double: false, mixed: false, pieces: 1, piece: 0 }
            .build(&points);
        let tags = bytes.windows(6).enumerate().filter(|(_, tag)| tag == b"\nARRAY");
        for tag in tags.map(|(at, _)| at).collect::<Vec<_>>() {
            // The count follows the tag, a name (3 letters in all three arrays), the flag and the
            // type.
            let count_at = tag + 6 + 4 + 3 + 4 + 4;
            let mut bytes = bytes.clone();
            let width = if wide { 8 } else { 4 };
            for field in [0, width] {
                let top = if wide { 0x80 } else { 0x7f };
                bytes[count_at + field] = top;
            }
            cases.push((bi4::read_particles, bytes));
        }
    }
    assert_eq!(
        cases.len(),
        2 + 3 * 2 + 2 * 3,
        "two counts of .bgeo, six shapes of .npy, and three arrays of .bi4 in two widths"
    );
    for (reader, bytes) in cases {
        let (result, largest) = memory::largest_allocation(|| reader(bytes.into()));
        let fault = result.expect_err("refused");
        assert!(
            matches!(fault, ReadFault::Truncated { .. } | ReadFault::Malformed { .. }),
            "{fault}"
        );
        assert!(largest < 4096, "{largest} bytes for: {fault}");
    }
}

#[test]
fn huge_counts_of_encoded_numbers_are_refused_without_allocating() {
    let points = tuples(7);
    let mut cases: Vec<(Reader, Vec<u8>)> = Vec::new();
    for layout in VtkXml::all() {
        let bytes = layout.build(&points);
        let text = String::from_utf8_lossy(&bytes).into_owned();
        for count in ["8", "1000000000", "1537228672809129301", "18446744073709551615"] {
            let wrong = format!("NumberOfPoints=\"{count}\"");
            let at = text.find("NumberOfPoints=\"7\"").unwrap();
            let rest = at + "NumberOfPoints=\"7\"".len();
            cases.push((VTU, [&bytes[..at], wrong.as_bytes(), &bytes[rest..]].concat()));
        }
        if layout.placed == Placed::AppendedRaw {
            let data = bytes.windows(2).position(|at| at == b" _").unwrap() + 2;
            for field in 0..if layout.is_compressed() { 3 } else { 1 } {
                let width = if layout.wide { 8 } else { 4 };
                let mut bytes = bytes.clone();
                // The last element of the file, AppendedData, contains the array of points. Find
                // its offset.
                let offset: usize = text
                    .split("Name=\"Points\"")
                    .nth(1)
                    .unwrap()
                    .split('"')
                    .nth(5)
                    .unwrap()
                    .parse()
                    .unwrap();
                bytes[data + offset + field * width..][..width].fill(0x7f);
                cases.push((VTU, bytes));
            }
        }
    }
    for shape in [
        "(2000000000, 3)",
        "(18446744073709551615, 3)",
        "(6148914691236517206, 3)",
        "(1, 2000000000)",
    ] {
        let array = [build::npy_header("<f4", false, shape), vec![0; 24]].concat();
        for compression in [CompressionMethod::Stored, CompressionMethod::Deflated] {
            cases.push((NPZ, build::npz(&[("pos", array.clone())], compression)));
        }
    }
    let archive = build::npz_frame(&points, CompressionMethod::Stored);
    for field in [8, 10, 16] {
        let mut bytes = archive.clone();
        let end = bytes.len() - 22;
        bytes[end + field..][..2].fill(0xfe);
        cases.push((NPZ, bytes));
    }
    for (reader, bytes) in cases {
        let (result, largest) = memory::largest_allocation(|| reader(bytes.into()));
        let fault = result.expect_err("refused");
        assert!(largest < 1 << 20, "{largest} bytes for: {fault}");
    }
}

#[test]
fn a_last_vtk_block_size_without_blocks_is_refused() {
    for layout in
        VtkXml::all().into_iter().filter(|l| l.is_compressed() && l.placed == Placed::AppendedRaw)
    {
        // The coordinates of two points fit into one block, which is not full.
        let mut bytes = layout.build(&tuples(2));
        let text = String::from_utf8_lossy(&bytes).into_owned();
        let offset: usize = text
            .split("Name=\"Points\"")
            .nth(1)
            .unwrap()
            .split('"')
            .nth(5)
            .unwrap()
            .parse()
            .unwrap();
        let data = bytes.windows(2).position(|at| at == b" _").unwrap() + 2;
        bytes[data + offset..][..if layout.wide { 8 } else { 4 }].fill(0);
        assert!(fault(read(VTU, &bytes)).contains("a last block, but no blocks"), "{layout:?}");
    }
}

#[test]
fn an_npz_array_with_an_extreme_compression_ratio_is_refused() {
    let bomb = memory::unlimited(|| {
        let zeros =
            [build::npy_header("<f4", false, "(12000000, 3)"), vec![0; 144_000_000]].concat();
        build::npz(&[("pos", zeros)], CompressionMethod::Deflated)
    });
    let (result, largest) = memory::largest_allocation(|| read(NPZ, &bomb));
    let fault = result.expect_err("refused");
    assert!(matches!(fault, ReadFault::Compression(_)), "{fault}");
    assert!(largest < 1 << 20, "{largest} bytes");
}

#[test]
fn unsupported_arrays_and_parts_are_refused_with_advice() {
    let points = tuples(2);
    let of_pieces =
        Bi4 { big: false, wide: false, double: false, mixed: false, pieces: 3, piece: 0 };
    let mut info = of_pieces.build(&points);
    info[9..27].copy_from_slice(b"JPartDataBi4_Info ");
    let cases: [(Reader, Vec<u8>, &str); 7] = [
        (NPY, build::npy_header("|O", false, "(2, 3)"), "pickled"),
        (NPY, build::npy_header("<i8", false, "(2, 3)"), "float32"),
        (NPY, build::npy_header("<f4", false, "(2, 4)"), "shape (2, 4)"),
        (NPY, build::npy_header("<f4", false, "(6,)"), "shape (6,)"),
        (NPY, build::npy_header("<f4", false, "()"), "shape ()"),
        (bi4::read_particles, of_pieces.build(&points), "one of 3 pieces"),
        (bi4::read_particles, info, "Part_0000.bi4"),
    ];
    for (reader, bytes, words) in cases {
        let fault = read(reader, &bytes).expect_err(words);
        assert!(matches!(fault, ReadFault::Unsupported(_)), "{fault}");
        assert!(fault.to_string().contains(words), "{fault}");
    }
}

#[test]
fn tables_are_read_with_any_separators_comments_and_line_ends() {
    let same = [
        "1 2 3\n4 5 -6e-1\n",
        "1,2,3\r\n4,5,-6e-1",
        "1, 2, 3 # the first, no more\n4,5,-.6 # the second\n",
        "% by hand\n1,2,3\n// the second\n4,5,-6D-01\n! end\n",
        "\u{feff}# by hand\n1;2;3;\n\n4; 5; -6e-1;\n# end\n",
        "  1\t2\t3   # the first\n\t4  5  -0.6\n",
        "x y z\n1 2 3\n4 5 -.6\n",
        "a title\nX;Y;Z\n1;2;3\n4;5;-.6\n",
        "# z y x\n3 2 1\n-0.6 5 4\n",
        "# x y z of all particles\n1 2 3\n4 5 -.6\n",
        "title 1\n1,2,3\n4,5,-0.6\n",
        "\"Points:0\",\"Points:1\",\"Points:2\"\n1,2,3\n4,5,-0.6\n",
    ];
    for table in same {
        assert_eq!(
            positions(&text(table).expect(table)),
            [[1.0, 2.0, 3.0], [4.0, 5.0, -0.6]],
            "{table:?}"
        );
    }
}

#[test]
fn named_columns_become_attributes_with_their_components() {
    let table = "TimeStep [s];Np;Nbound\n0.5;2;0\n\n\
        Pos.x [m];Pos.y [m];Pos.z [m];Idp;Vel.x [m/s];Vel.y [m/s];Vel.z [m/s];Rhop [kg/m^3];\n\
        1;2;3;10;4;5;6;1000;\n7;8;9;11;-4;-5;-6;1001;\n";
    let file = text(table).unwrap();
    assert_eq!(positions(&file), [[1.0, 2.0, 3.0], [7.0, 8.0, 9.0]]);
    assert_eq!(attributes(&file), [("Idp", 1), ("Vel", 3), ("Rhop", 1)]);
    assert_eq!(attribute(&file, "Vel"), [4.0, 5.0, 6.0, -4.0, -5.0, -6.0]);
    assert_eq!(attribute(&file, "Rhop"), [1000.0, 1001.0]);

    let file = text("#\n# <x> <y> <z> <id> <a b> <v> <v> <v> \n1 2 3 4 5 6 7 8 \n\n").unwrap();
    assert_eq!(positions(&file), [[1.0, 2.0, 3.0]]);
    assert_eq!(attributes(&file), [("id", 1), ("a b", 1), ("v", 3)]);

    let file =
        text("id,vx,z,index,vy,y,x,vz,n:0,n:1,n:2,n:3\n1,2,3,8,4,5,6,7,9,10,11,12\n").unwrap();
    assert_eq!(positions(&file), [[6.0, 5.0, 3.0]]);
    assert_eq!(attributes(&file), [("id", 1), ("v", 3), ("index", 1), ("n", 3), ("n:3", 1)]);
    assert_eq!(attribute(&file, "v"), [2.0, 4.0, 7.0]);
    assert_eq!(attribute(&file, "n"), [9.0, 10.0, 11.0]);
}

#[test]
fn nan_and_infinity_are_read_in_all_spellings_of_text_formats() {
    for row in positions(&text("nan,inf,-inf\n1.#QNAN,1.#INF,-1.#INF\n").unwrap()) {
        assert!(row[0].is_nan());
        assert_eq!(row[1..], [f64::INFINITY, f64::NEG_INFINITY]);
    }
    let ascii = "# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS 2 double\n\
        1.5D-01 2 -nan(ind)\n-1.#IND 5 6\n";
    let points = positions(&read(VTK, ascii.as_bytes()).unwrap());
    assert_eq!(points[0][..2], [0.15, 2.0]);
    assert!(points[0][2].is_nan() && points[1][0].is_nan());
}

#[test]
fn exponents_mean_the_same_in_every_text_format() {
    let vtk = "# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS 2 double\n";
    let vtu = "<VTKFile type=\"UnstructuredGrid\"><UnstructuredGrid>\
        <Piece NumberOfPoints=\"2\" NumberOfCells=\"0\"><Points><DataArray type=\"Float64\" \
        NumberOfComponents=\"3\" format=\"ascii\">";
    let ply = "ply\nformat ascii 1.0\nelement vertex 2\nproperty double x\nproperty double y\n\
        property double z\nend_header\n";
    let dump = "ITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n2\nITEM: BOX BOUNDS pp pp pp\n\
        0.0D+00 1.5D+03\n0 1e5\n0 1\nITEM: ATOMS x y z\n";
    let rows = "1.5D+03 0.14-270 1e5\n-1.5d3 1.5E+3 -2Q2\n";
    let formats: [(Reader, String, &str); 9] = [
        (TEXT, String::new(), ""),
        (TEXT, "x y z\n".into(), ""),
        (TEXT, "VARIABLES = x y z\nZONE I=2, DATAPACKING=POINT\n".into(), ""),
        (XYZ, String::new(), ""),
        (XYZ, "2\nTime=1.5D+03 Lattice=\"1d1 0 0 0 1D1 0 0 0 1\"\n".into(), ""),
        (VTK, vtk.into(), ""),
        (VTU, vtu.into(), "</DataArray></Points></Piece></UnstructuredGrid></VTKFile>"),
        (|bytes| ply::read_particles(bytes, Unpacking::in_memory()), ply.into(), ""),
        (
            |bytes| read_text(bytes, InputFormat::Lammps, None, WantedAttributes::All),
            dump.into(),
            "",
        ),
    ];
    let expected = [[1500.0, 0.14e-270, 1e5], [-1500.0, 1500.0, -200.0]];
    for (reader, head, tail) in formats {
        let text = head + rows + tail;
        let file = read(reader, text.as_bytes()).unwrap_or_else(|e| panic!("{e}: {text}"));
        assert_eq!(positions(&file), expected, "{text}");
        match file.format {
            "XYZ" => {
                assert_eq!((file.time, file.box_size), (Some(1500.0), Some([10.0, 10.0, 1.0])))
            }
            "LAMMPS dump" => assert_eq!(file.box_size, Some([1500.0, 1e5, 1.0])),
            _ => {}
        }
    }
    let commas = rows.replace(' ', ",");
    assert_eq!(positions(&text(&commas).unwrap()), expected);
    let semicolons = commas.replace(',', ";").replace('.', ",");
    assert_eq!(positions(&text(&semicolons).unwrap()), expected);
}

#[test]
fn an_invalid_line_is_reported_with_its_number_and_text() {
    let cases = [
        ("1,2,3\n4,5\n", 2, "\"4,5\""),
        ("1,2,3\n4,5,6,7\n", 2, "expected 3 fields, found 4"),
        ("x,y,z\n\n1,2,3\n4,5#,6\n", 4, "\"5#\""),
        ("x;y;z\n1,5;2,5;3,5\n1.5;2,5;3,5\n", 3, "\"1.5\""),
        ("x,y,z\n1,2,3\n4,*****,6\n", 3, "Fortran"),
        ("1 2 3\n# note\n\nx y z\n", 4, "\"x\""),
        ("1.0 2.0 *****\n1 2 3\n4 5 6\n", 1, "*****"),
        ("1 2 3x\n1 2 3\n4 5 6\n", 1, "3x"),
        ("1 2\n", 1, "2 fields"),
        ("a,b,c\n1,2,3\n", 1, "\"a\", \"b\", \"c\""),
        ("hello\n", 1, "\"hello\""),
        ("first\nsecond\n", 1, "\"first\""),
        ("x,y\n1,2\n", 1, "\"x\", \"y\""),
        ("# x y rho\n1 2 3\n", 1, "\"rho\""),
        ("# <x> <y> <id> <a b>\n1 2 3 4\n\n5 6 7 8\n", 1, "\"a b\""),
    ];
    for (table, at, shown) in cases {
        match text(table) {
            Err(ReadFault::Line { line, what }) => {
                assert_eq!(line, at, "{table:?}: {what}");
                assert!(what.contains(shown), "{table:?}: {what}");
            }
            other => panic!("{table:?}: {other:?}"),
        }
    }
}

#[test]
fn tables_are_read_with_decimal_commas_units_quotes_and_utf_16() {
    let utf16 = |text: &str, swap: bool| -> Vec<u8> {
        let units = std::iter::once(0xfeff).chain(text.encode_utf16());
        units.flat_map(|unit| if swap { unit.to_be_bytes() } else { unit.to_le_bytes() }).collect()
    };
    let plain = "x,y,z\n0.5,2,3\n4,5,-0.25\n";
    let same = [
        b"x;y;z\n0,5;2;3\n4;5;-0,25\n".to_vec(),
        b"x\ty\tz\n0,5\t2\t3\n4\t5\t-0,25\n".to_vec(),
        b"0;2;0,5;a\n".to_vec(),
        b"x y z\n0,5 2,0 3,0\n4,0 5,0 -0,25\n".to_vec(),
        b"x,y,z\n[m],[m],[m]\n0.5,2,3\n4,5,-0.25\n".to_vec(),
        b"\"x\",\"y\",\"z\",\"name\"\n\"0.5\",\"2\",\"3\",\"a, b\"\n\"4\",\"5\",\"-0.25\",\"\"\n"
            .to_vec(),
        b"x,raw,y,z\n0.5,\x03,2,3\n4,#,5,-0.25\n".to_vec(),
        utf16(plain, false),
        utf16(plain, true),
    ];
    for table in same {
        let file = read(TEXT, &table).unwrap_or_else(|e| panic!("{e}: {table:?}"));
        let expected = match table[..3] {
            [b'0', b';', b'2'] => vec![[0.0, 2.0, 0.5]],
            _ => vec![[0.5, 2.0, 3.0], [4.0, 5.0, -0.25]],
        };
        assert_eq!(positions(&file), expected, "{:?}", String::from_utf8_lossy(&table));
        assert!(attributes(&file).is_empty());
    }
}

#[test]
fn table_values_are_parsed_only_in_wanted_columns() {
    let table = "x,y,z,p,vx,vy,vz\n1,2,3,1,4,5,6\n1,2,3,,4,5,6\n1,2,3,bad,4,5,6\n,2,3,1,NA,5,6\n";
    let read = |names: &[&str]| {
        let names: Vec<String> = names.iter().map(|name| (*name).to_owned()).collect();
        let wanted = WantedAttributes::Only {
            names: Some(&names),
            conditions: &[],
            sizes: &SizeChoice::Ignored,
        };
        read_text(table.as_bytes().to_vec().into(), InputFormat::Csv, None, wanted)
    };
    let file = read(&["velocity"]).unwrap();
    assert_eq!(attributes(&file), [("v", 3)]);
    assert_eq!(file.unread.len(), 1);
    assert!(positions(&file)[3][0].is_nan() && attribute(&file, "v")[9].is_nan());
    assert!(matches!(read(&["p"]), Err(ReadFault::Line { line: 4, .. })));
    // If all columns are wanted, a column that contains text is omitted.
    assert_eq!(attributes(&text(table).unwrap()), [("v", 3)]);
}

#[test]
fn unnamed_tables_may_start_with_a_label_or_row_number_column() {
    let expected = [[0.5, 2.5, 3.5], [4.5, 5.5, 0.25], [1.5, 0.5, 7.5]];
    for table in [
        "O 0.5 2.5 3.5\nH 4.5 5.5 0.25\nH 1.5 0.5 7.5\n",
        "1 O 0.5 2.5 3.5\n2 H 4.5 5.5 0.25\n3 H 1.5 0.5 7.5\n",
        "0,0.5,2.5,3.5\n1,4.5,5.5,0.25\n2,1.5,0.5,7.5\n",
        "3\n0.5 2.5 3.5 1\n4.5 5.5 0.25 2\n1.5 0.5 7.5 3\n",
    ] {
        assert_eq!(positions(&text(table).expect(table)), expected, "{table:?}");
    }
}

#[test]
fn xyz_frames_consist_of_a_count_a_comment_and_rows() {
    let expected = [[0.5, 2.0, 3.5], [4.0, 5.5, -0.25]];
    for frame in [
        "2\nwater\nO 0.5 2 3.5\nH 4 5.5 -0.25\n",
        "2\n\n0.5 2 3.5\n4 5.5 -0.25\n\n",
        "2\n1 1 1\n0.5 2 3.5\n4 5.5 -0.25",
        "2\r\nt\r\n8 0.5 2.0 3.5\r\n1 4.0 5.5 -0.25\r\n",
        "2\nProperties=id:I:1:species:S:1:pos:R:3\n1 O 0.5 2 3.5\n2 H 4 5.5 -0.25\n",
        "2\n# rho x y z\n1 0.5 2 3.5\n1 4 5.5 -0.25\n",
    ] {
        let file = read(XYZ, frame.as_bytes()).unwrap_or_else(|e| panic!("{e}: {frame:?}"));
        assert_eq!(positions(&file), expected, "{frame:?}");
    }
    let extended = "1\nLattice=\"2 0 0 0 3 0 0 0 4\" Properties=species:S:1:pos:R:3:velo:R:3 Time=0.5\n\
        O 1 2 3 4 5 6\n";
    let file = read(XYZ, extended.as_bytes()).unwrap();
    assert_eq!((file.time, file.box_size), (Some(0.5), Some([2.0, 3.0, 4.0])));
    assert_eq!(attribute(&file, "velocity"), [4.0, 5.0, 6.0]);
    for (wrong, at) in [
        ("3\nwater\nO 0 0 0\nO 1 1 1\n", 4),
        ("1\nwater\nO 0 0 0\nO 1 1 1\n", 4),
        ("3\n0.5 2 3\n4 5 6\n", 3),
        ("1\nProperties=species:S:1\nO\n", 2),
    ] {
        let fault = read(XYZ, wrong.as_bytes()).expect_err(wrong);
        assert!(matches!(fault, ReadFault::Line { line, .. } if line == at), "{wrong:?}: {fault}");
    }
}

#[test]
fn frames_of_xyz_files_and_steps_of_lammps_dumps_are_read_separately() {
    let frames = "1\na\nO 1 1 1\n2\nb\nO 2 2 2\nO 3 3 3\n";
    let steps = |text: &str, format| {
        text_format::steps(text.as_bytes().to_vec().into(), TextHint::Extension(Some(format)))
    };
    let step = |text: &str, format, step| {
        read_text(text.as_bytes().to_vec().into(), format, step, WantedAttributes::All)
    };
    assert_eq!(steps(frames, InputFormat::Xyz).unwrap(), [0, 1]);
    let second = step(frames, InputFormat::Xyz, Some(1)).unwrap();
    assert_eq!(positions(&second), [[2.0; 3], [3.0; 3]]);
    for wrong in [None, Some(2)] {
        let fault = step(frames, InputFormat::Xyz, wrong).expect_err("no such frame");
        assert!(matches!(fault, ReadFault::Unsupported(_)), "{fault}");
    }

    let frame = |number: u64, rows: &str| {
        format!(
            "ITEM: TIMESTEP\n{number}\nITEM: NUMBER OF ATOMS\n2\nITEM: BOX BOUNDS pp pp pp\n\
             1 3\n0 2e0\n0 4\nITEM: ATOMS id element xs ys zs vx vy vz\n{rows}"
        )
    };
    let dump =
        [100, 0].map(|number| frame(number, "1 O 0 0 0 1 2 3\n2 H 0.5 0.5 1 4 5 6\n")).concat();
    for format in [InputFormat::Lammps, InputFormat::Csv] {
        assert_eq!(steps(&dump, format).unwrap(), [0, 100]);
        let file = step(&dump, format, Some(100)).unwrap();
        assert_eq!(positions(&file), [[1.0, 0.0, 0.0], [2.0, 1.0, 4.0]]);
        assert_eq!(attributes(&file), [("id", 1), ("v", 3)]);
        assert_eq!(file.box_size, Some([2.0, 2.0, 4.0]));
        assert!(matches!(step(&dump, format, None), Err(ReadFault::Unsupported(_))));
    }
    let cut = frame(5, "1 O 0 0 0 1 2 3\n");
    assert!(matches!(step(&cut, InputFormat::Lammps, None), Err(ReadFault::Line { line: 10, .. })));

    // After a restart from step 0, the simulator repeats step 100.
    let again = [dump.as_str(), &frame(100, "1 O 1 1 1 0 0 0\n2 H 0 0 0 0 0 0\n")].concat();
    assert_eq!(steps(&again, InputFormat::Lammps).unwrap(), [0, 100]);
    let file = step(&again, InputFormat::Lammps, Some(100)).unwrap();
    assert_eq!(positions(&file), [[3.0, 2.0, 4.0], [1.0, 0.0, 0.0]]);
    assert_eq!(file.left_out, [UnreadPart::RepeatedStep]);
    assert_eq!(step(&again, InputFormat::Lammps, Some(0)).unwrap().left_out, []);
}

#[test]
fn scaled_lammps_coordinates_follow_the_edges_of_the_box() {
    let boxes = [
        // A tilted box: x from 0 to 2 and y from 0 to 3, with the tilts xy 1, xz 0 and yz 0.5.
        "xy xz yz pp pp pp\n0 3 1\n0 3.5 0\n0 4 0.5\n",
        "abc origin pp pp pp\n2 0 0 0\n1 3 0 0\n0 0.5 4 0\n",
    ];
    for bounds in boxes {
        let dump = format!(
            "ITEM: UNITS\nlj\nITEM: TIME\n0.25\nITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n1\n\
             ITEM: BOX BOUNDS {bounds}ITEM: ATOMS x xsu ysu zsu\n7 0.5 0.5 0.5\n"
        );
        let file = text(&dump).unwrap();
        assert_eq!(positions(&file), [[1.5, 1.75, 2.0]], "{bounds}");
        assert_eq!(file.time, Some(0.25));
    }
}

#[test]
fn tecplot_is_read_in_point_and_block_packing() {
    let head = "TITLE = \"a\"\nVARIABLES = \"x\", \"y\" \"z\" \"rho\"\nZONE T=\"b, c\", I=2,";
    for zone in [
        "F=POINT\n1 2 3 10\n4 5 6\n20\n",
        "DATAPACKING=BLOCK, SOLUTIONTIME=0.5\n1 4 2 5\n3 6 10 20\n",
    ] {
        let file = text(&format!("{head} {zone}")).unwrap();
        assert_eq!(positions(&file), [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
        assert_eq!(attribute(&file, "rho"), [10.0, 20.0]);
    }
    let text_and_line = "TEXT X=1, Y=2,\nT=\"6 m\"\nGEOMETRY T=LINE\n1\n2\n0 0\n1 1\nZONE";
    let decorated =
        format!("{} F=POINT\n1 2 3 10\n4 5 6 20\n", head.replace("ZONE", text_and_line));
    assert_eq!(attribute(&text(&decorated).unwrap(), "rho"), [10.0, 20.0]);
    let unsized_zone = text("variables = x y z\nzone\n1 2 3\n4 5 6\n").unwrap();
    assert_eq!(positions(&unsized_zone).len(), 2);
    for (zone, line) in [
        ("F=POINT\n1 2 3 10\n4 5 6 20\nZONE I=1\n1 2 3 4\n", 6),
        ("F=POINT\n1 2 3 10\n4 5 6 20\nTITLE = \"b\"\nVARIABLES = x, y, z\nZONE I=1\n1 2 3\n", 6),
        ("F=POINT\n1 2 3 10\n4 5 6\n", 3),
        ("F=POINT\n8*1\n", 4),
        ("N=2, E=1, ZONETYPE=FETRIANGLE\n1 2 3 10\n", 3),
    ] {
        match text(&format!("{head} {zone}")) {
            Err(ReadFault::Line { line: at, what }) => assert_eq!(at, line, "{what}"),
            other => panic!("{zone}: {other:?}"),
        }
    }
    let undecided = text(&format!("{head}\n1 2 3 10\n4 5 6 20\n"));
    assert!(matches!(undecided, Err(ReadFault::Unsupported(_))));
}

#[test]
fn only_a_json_list_of_positions_is_read() {
    let json =
        |text: &str| json::read_particles(text.as_bytes().to_vec().into(), Unpacking::in_memory());
    let file = json("[[1, 2, 3],\n [4.5, -5e-1, 6]]\n").unwrap();
    assert_eq!(positions(&file), [[1.0, 2.0, 3.0], [4.5, -0.5, 6.0]]);
    assert!(positions(&json("[]").unwrap()).is_empty());
    for (wrong, at) in [
        ("{\"pos\": [[1, 2, 3]]}", 1),
        ("[[1, 2, 3],\n[1, 2]]", 2),
        ("[[1, 2, 3, 4]]", 1),
        ("[[1, 2, 3]] 4", 1),
        ("[[1, 2, NaN]]", 1),
        ("[[1, 2, 3]", 1),
        ("", 1),
    ] {
        let fault = json(wrong).expect_err(wrong);
        assert!(matches!(fault, ReadFault::Line { line, .. } if line == at), "{wrong:?}: {fault}");
    }
    for (width, remedy) in [(2, "z that is 0"), (4, ".csv"), (6, ".csv")] {
        let row = vec!["1"; width].join(",");
        let fault = json(&format!("[[{row}],[{row}]]")).unwrap_err().to_string();
        assert!(fault.contains(&format!("{width} numbers")) && fault.contains(remedy), "{fault}");
    }
    assert!(json(&"[".repeat(100_000)).is_err());
}

#[test]
fn decoding_a_table_is_independent_of_the_number_of_threads() {
    let rows = 200_000;
    let mut table = String::from("x,y,z\n");
    for i in 0..rows {
        table += &format!("{},{},{}\n", i, f64::from(i) * 0.1, -i);
    }
    let decode = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| positions(&text(&table).unwrap()))
    };
    let one = decode(1);
    assert_eq!(one, decode(3));
    assert_eq!(one.len(), rows as usize);
    assert!(
        one.iter().zip(0..).all(|(p, i)| *p == [f64::from(i), f64::from(i) * 0.1, -f64::from(i)])
    );

    let bad = table.replace("\n150000,", "\n150000.0.0,");
    assert_eq!(fault(text(&bad)), "line 150002: \"150000.0.0\" is not a number (column x)");
}

#[test]
fn a_truncated_table_gives_its_first_rows_or_an_error() {
    let table = "x,y,z,vx,vy,vz\n1,2,3,4,5,6\n10,20,30,40,50,60\n7,8,9,10,11,12\n";
    let whole = positions(&text(table).unwrap());
    for end in 1..table.len() {
        if let Ok(file) = text(&table[..end]) {
            let rows = positions(&file);
            assert_eq!(rows, whole[..rows.len()], "cut at {end}");
            assert!(rows.is_empty() || attributes(&file) == [("v", 3)], "cut at {end}");
        }
    }
}

#[test]
fn the_bytes_of_an_xyz_decide_whether_it_is_text_or_raw() {
    let raw = read(XYZ, &build::raw(&tuples(7))).unwrap();
    assert_eq!((raw.format, positions(&raw)), ("raw f32 .xyz", tuples(7)));
    let accents = format!("# {}\n1 2 3\n", "\u{e9}".repeat(3000));
    for start in [accents.clone(), format!(" {accents}")] {
        let table = read(XYZ, start.as_bytes()).unwrap();
        assert_eq!((table.format, positions(&table)), ("text table", vec![[1.0, 2.0, 3.0]]));
    }
    let wide = tuples(8).into_iter().flatten().flat_map(|x| (x + 0.1).to_le_bytes());
    let fault = read(XYZ, &wide.collect::<Vec<_>>()).expect_err("the file contains f64");
    assert!(matches!(fault, ReadFault::Unsupported(_)), "{fault}");
}

#[test]
fn an_unknown_extension_is_refused_before_the_file_is_opened() {
    for name in
        ["nowhere/a.obj", "nowhere/a", "nowhere/a.ibi4", "nowhere/.bgeo/a", "nowhere/a.obj.gz"]
    {
        let fault = open_particles(Path::new(name)).expect_err("refused").fault;
        assert!(matches!(fault, ReadFault::UnknownExtension { .. }), "{name}: {fault}");
    }
    let fault = open_particles(Path::new("nowhere/a.BGEO")).expect_err("refused").fault;
    assert!(matches!(fault, ReadFault::Io(_)), "{fault}");
}

#[test]
fn the_spacing_is_found_in_scene_files_next_to_or_above_the_frames() {
    let (spacing, scene) =
        spacing_from_scene(&data("dambreak_small/ParticleData_Fluid_1.bgeo")).unwrap();
    assert_eq!((spacing, scene), (0.05, data("dambreak_small/scene.json")));
    let (spacing, case) =
        spacing_from_scene(&data("dualsphysics_dambreak/particles/PartFluid_0000.vtk")).unwrap();
    assert_eq!((spacing, case), (0.02, data("dualsphysics_dambreak/CaseDambreak.xml")));

    let folder = tempfile::tempdir().unwrap();
    let frames = folder.path().join("run/frames");
    std::fs::create_dir_all(&frames).unwrap();
    let frame = frames.join("a.bgeo");
    let scene = |radius: &str| format!(r#"{{"Configuration": {{"particleRadius": {radius}}}}}"#);
    assert_eq!(spacing_from_scene(&frame), None);
    std::fs::write(folder.path().join("run/z.json"), scene("1")).unwrap();
    assert_eq!(spacing_from_scene(&frame).unwrap().0, 2.0);
    std::fs::write(frames.join("b.json"), scene("3")).unwrap();
    for other in 'c'..='z' {
        std::fs::write(frames.join(format!("{other}.json")), scene("3")).unwrap();
    }
    for (name, no_scene) in [
        ("0.json", scene("-1")),
        ("1.json", "[".repeat(100_000)),
        ("2.json", "{}".into()),
        ("3.xml", "<mesh><dp value=\"5\"/></mesh>".into()),
        ("4.xml", "<case><dp value=\"five\"/></case>".into()),
        ("5.xml", "<a".repeat(100_000)),
        ("6.json", scene(&format!("{}1", " ".repeat(17 << 20)))),
    ] {
        std::fs::write(frames.join(name), no_scene).unwrap();
    }
    assert_eq!(spacing_from_scene(&frame).unwrap(), (6.0, frames.join("b.json")));
    std::fs::write(frames.join("y.json"), scene("4")).unwrap();
    assert_eq!(spacing_from_scene(&frame), None);
}

#[test]
fn a_changed_compressed_file_of_frames_is_decompressed_again() {
    let folder = tempfile::tempdir().unwrap();
    let open = |name: &str, scratch: &Path| {
        let unpacking = Unpacking { in_memory: 1 << 20, scratch, control: None };
        input::open_particles(&folder.path().join(name), unpacking).map(|file| positions(&file))
    };
    let frames = |first: i32| -> String {
        (first..first + 3).map(|x| format!("1\nframe\nO {x}.5 0 0\n")).collect()
    };
    let write = |name: &str, bytes: &[u8]| std::fs::write(folder.path().join(name), bytes).unwrap();
    write("a.xyz", frames(0).as_bytes());
    write("b.xyz.gz", &gzip(frames(0).as_bytes()));
    for name in ["a.xyz", "b.xyz.gz"] {
        // If there is no scratch folder, the file is unpacked in memory.
        for scratch in [Path::new("nowhere"), folder.path(), Path::new("nowhere")] {
            for (number, x) in [(2, 2.5), (0, 0.5), (1, 1.5)] {
                let read = open(&format!("{name}#{number}"), scratch).unwrap();
                assert_eq!(read, [[x, 0.0, 0.0]], "{name}#{number}");
            }
            open(&format!("{name}#3"), scratch).unwrap_err();
        }
    }
    write("a.xyz", frames(10).as_bytes());
    write("b.xyz.gz", &gzip(frames(10).as_bytes()));
    for name in ["a.xyz#1", "b.xyz.gz#1"] {
        assert_eq!(open(name, folder.path()).unwrap(), [[11.5, 0.0, 0.0]], "{name}");
    }
}

#[test]
fn frames_before_an_invalid_line_can_be_read_by_number() {
    let frames = "1\na\nO 1 1 1\n1\nb\nO 2 2 2\nnext\n";
    let step = |step| {
        read_text(frames.as_bytes().to_vec().into(), InputFormat::Xyz, step, WantedAttributes::All)
    };
    assert_eq!(positions(&step(Some(1)).unwrap()), [[2.0; 3]]);
    for wrong in [None, Some(2)] {
        assert!(matches!(step(wrong), Err(ReadFault::Line { line: 7, .. })));
    }
}

#[test]
fn a_given_text_format_is_not_detected_from_the_content() {
    let folder = tempfile::tempdir().unwrap();
    let open = |text: &str, format| {
        let path = folder.path().join("sim.out");
        std::fs::write(&path, text).unwrap();
        let wanted = WantedParticles { format: Some(format), ..WantedParticles::default() };
        input::open_wanted(&path, wanted, Unpacking::in_memory()).map(|file| file.format)
    };
    let xyz = "2\nwater\nO 1 2 3\nH 4 5 6\n";
    let tecplot = "VARIABLES = x, y, z\nZONE\n1 2 3\n";
    assert_eq!(open(xyz, InputFormat::Xyz).unwrap(), "XYZ");
    assert_eq!(open(xyz, InputFormat::Csv).unwrap(), "text table");
    assert_eq!(open(tecplot, InputFormat::Tecplot).unwrap(), "Tecplot");
    open(tecplot, InputFormat::Csv).unwrap_err();
    open("ITEM: TIMESTEP\n0\n", InputFormat::Csv).unwrap_err();
    open("x,y,z\n1,2,3\n", InputFormat::Lammps).unwrap_err();
    open("x,y,z\n1,2,3\n", InputFormat::Tecplot).unwrap_err();
}

#[test]
fn several_tecplot_zones_are_refused_with_their_titles() {
    let file =
        "VARIABLES = x, y, z\nZONE T=\"fluid\"\n1 2 3\nzone t=\"wall\"\n4 5 6\nZONE\n7 8 9\n";
    match text(file) {
        Err(ReadFault::Line { line: 4, what }) => {
            assert!(what.contains("has 3") && what.contains("\"fluid\""), "{what}");
            assert!(what.contains("\"wall\""), "{what}");
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn equal_attribute_columns_are_numbered_but_equal_axes_are_refused() {
    let file = text("x,y,z,a,a\n1,2,3,4,5\n").unwrap();
    assert_eq!(attributes(&file), [("a_column4", 1), ("a_column5", 1)]);
    assert_eq!(attribute(&file, "a_column5"), [5.0]);
    let twice = text("x,y,z,vx,vy,vz,vx\n1,2,3,4,5,6,7\n").unwrap();
    assert!(attributes(&twice).iter().all(|(_, components)| *components == 1));
    for names in ["x,y,z,x,y,z", "# x,y,z,x,y,z", "x,y,z,X,x,y"] {
        let fault = text(&format!("{names}\n1,2,3,4,5,6\n")).expect_err(names);
        assert!(matches!(fault, ReadFault::Line { line: 1, .. }), "{names}: {fault}");
    }
    let named = read(XYZ, b"1\nx y z x y z\n1.5 2.5 3.5 4.5 5.5 6.5\n");
    assert!(matches!(named, Err(ReadFault::Line { .. })));
}

#[test]
fn red_green_and_blue_columns_become_a_colour() {
    for (names, components) in [("Red,Green,Blue", 3), ("r,g,b", 3), ("red,green,blue,alpha", 4)] {
        let shares = ["255", "128", "0", "64"][..components].join(",");
        let file = text(&format!("x,y,z,{names}\n1,2,3,{shares}\n")).unwrap();
        assert_eq!(attributes(&file), [("color", components)], "{names}");
    }
    assert_eq!(attributes(&text("x,y,z,r,g\n1,2,3,4,5\n").unwrap()), [("r", 1), ("g", 1)]);
}

#[test]
fn half_precision_numpy_arrays_are_read() {
    let mut npy = b"\x93NUMPY\x01\x00\x46\x00".to_vec();
    npy.extend(
        format!("{:<69}\n", "{'descr': '<f2', 'fortran_order': False, 'shape': (1, 3)}").bytes(),
    );
    for bits in [0x3c00_u16, 0xb800, 0x0001] {
        npy.extend(bits.to_le_bytes());
    }
    let file = read(NPY, &npy).unwrap();
    assert_eq!(positions(&file), [[1.0, -0.5, 2.0_f64.powi(-24)]]);
}

#[test]
fn a_condition_on_a_vtk_string_array_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let legacy = "# vtk DataFile Version 3.0\nt\nASCII\nDATASET POLYDATA\nPOINTS 1 float\n1 2 3\n\
        POINT_DATA 1\nFIELD f 1\nphase 1 1 string\nwater\n";
    let xml = "<VTKFile type=\"PolyData\"><PolyData><Piece NumberOfPoints=\"1\"><PointData>\
        <DataArray type=\"String\" Name=\"phase\" format=\"ascii\">119 0</DataArray></PointData>\
        <Points><DataArray type=\"Float32\" NumberOfComponents=\"3\" format=\"ascii\">1 2 3\
        </DataArray></Points></Piece></PolyData></VTKFile>";
    let conditions = ["phase=water".parse().unwrap()];
    for (name, content) in [("a.vtk", legacy), ("a.vtp", xml)] {
        let path = folder.path().join(name);
        std::fs::write(&path, content).unwrap();
        input::open_particles(&path, Unpacking::in_memory()).expect(name);
        let wanted = WantedParticles { conditions: &conditions, ..WantedParticles::default() };
        match input::open_wanted(&path, wanted, Unpacking::in_memory()).map_err(|e| e.fault) {
            Err(ReadFault::Unsupported(what)) => assert!(what.contains("phase"), "{what}"),
            other => panic!("{name}: {other:?}"),
        }
    }
}

#[test]
fn conditions_on_64_bit_integers_and_the_listed_values_are_exact() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.npz");
    let least = 1_i64 << 53;
    let ids: Vec<u8> = (0..8).flat_map(|i| (least + i / 2).to_le_bytes()).collect();
    let ids = [build::npy_header("<i8", false, "(8,)"), ids].concat();
    let arrays = [("pos", build::npy(&tuples(8), "<f8", false)), ("id", ids)];
    std::fs::write(&path, build::npz(&arrays, CompressionMethod::Stored)).unwrap();
    let open = |comparison: &str, value: String| {
        let conditions = [format!("id{comparison}{value}").parse().unwrap()];
        let wanted = WantedParticles { conditions: &conditions, ..WantedParticles::default() };
        input::open_wanted(&path, wanted, Unpacking::in_memory()).unwrap()
    };
    let count = |comparison, value: String| open(comparison, value).particles.len();
    for (at, [less, equal, more]) in [(0, [0, 2, 6]), (1, [2, 2, 4]), (3, [6, 2, 0])] {
        let value = |at: i64| (least + at).to_string();
        assert_eq!(count("<", value(at)), less, "{at}");
        assert_eq!(count("<=", value(at)), less + equal, "{at}");
        assert_eq!(count("=", value(at)), equal, "{at}");
        assert_eq!(count("!=", value(at)), less + more, "{at}");
        assert_eq!(count(">", value(at)), more, "{at}");
        assert_eq!(count(">=", value(at)), equal + more, "{at}");
    }
    // Test other notations of numbers.
    assert_eq!(count(">", format!("{least}.0")), 6);
    assert_eq!(count(">", "9.007199254740992e15".to_owned()), 6);
    assert_eq!(count(">", "0.5".to_owned()), 8);
    assert_eq!(count("<", "1e300".to_owned()), 8);
    let Some(SelectionFault::None { values, .. }) = open("=", "7".to_owned()).none_selected else {
        panic!("a particle is selected")
    };
    let values: Vec<_> = values[0].values.iter().map(|(value, _)| value.to_string()).collect();
    assert_eq!(values, [0, 1, 2, 3].map(|i| (least + i).to_string()));
}
