//! Tests of damaged and inconsistent .ply and .vtk files.

use std::io::Write;

use meniscus::internals::io::bytes::open_bytes;
use meniscus::internals::io::{ParticleFile, ReadFault, vtk};
use tempfile::NamedTempFile;

use super::vtk_particles::{field, flagged};
use super::{
    ENCODINGS, Format, PLY, VTK, VtkBuilder, attributes, dual, ply_with_face, positions, splish,
    toolkit,
};

/// Reads a file with all three readers, and compares reading from disk with reading from memory.
fn read_all(format: Format, bytes: &[u8]) -> [Result<(), ReadFault>; 3] {
    let numbers = |file: ParticleFile| (positions(&file), attributes(&file));
    let particles = format.particles(bytes).map(numbers);
    if bytes.len() > 1 {
        let mut written = NamedTempFile::new().expect("a temporary file");
        written.write_all(bytes).expect("a temporary file");
        let opened = open_bytes(written.path()).expect("a temporary file");
        if !vtk::is_text(opened.view()) {
            let [by_position, in_memory] = [opened.view(), bytes.into()].map(format.has_faces);
            assert_eq!(format!("{by_position:?}"), format!("{in_memory:?}"));
        }
        let by_position = (format.read_particles)(opened).map(numbers);
        assert_eq!(
            format!("{by_position:?}"),
            format!("{particles:?}"),
            "reading by position differs from reading in memory"
        );
    }
    let particles = particles.map(|_| ());
    [particles, (format.read_mesh)(bytes).map(|_| ()), (format.has_faces)(bytes.into()).map(|_| ())]
}

#[test]
fn a_truncated_ply_is_refused_at_every_length() {
    for encoding in ENCODINGS {
        let file = ply_with_face(encoding);
        let rows_end = match encoding {
            "ascii" => file.len() - "\n3 0 1 2\n".len(),
            _ => file.len() - 13,
        };
        let faces_end = file.len() - usize::from(encoding == "ascii");
        for cut in 0..file.len() {
            let [particles, mesh, _] = read_all(PLY, &file[..cut]);
            assert_eq!(particles.is_ok(), cut >= rows_end, "{encoding}: particles of {cut} bytes");
            assert_eq!(mesh.is_ok(), cut >= faces_end, "{encoding}: mesh of {cut} bytes");
        }
    }
}

/// Files with all kinds of data sets and cells. Each file has six points, and some of the vertices
/// are flagged.
fn with_ghosts(ascii: bool) -> Vec<VtkBuilder> {
    let file = |version: &str, types: Option<&[f64]>| {
        let corners = [5., 4., 3., 2., 1., 0.];
        flagged(ascii, version, 6, &corners, types, |file| {
            field(file, "vtkGhostType", &[1., 0., 0., 32., 0., 8.])
        })
    };
    ["3.0", "5.1"]
        .into_iter()
        .flat_map(|version| [None, Some(&[1.0; 6][..])].map(|types| file(version, types)))
        .collect()
}

#[test]
fn flipped_bytes_in_a_vtk_with_cell_flags_never_panic() {
    let mut refused = 0;
    for ascii in [true, false] {
        for file in with_ghosts(ascii) {
            for at in 0..file.bytes.len() {
                for flip in [0x01, 0x80, 0xff] {
                    let mut bytes = file.bytes.clone();
                    bytes[at] ^= flip;
                    refused += usize::from(read_all(VTK, &bytes)[0].is_err());
                }
            }
        }
    }
    assert!(refused > 1000, "{refused}");
}

#[test]
fn a_truncated_vtk_is_refused_unless_it_ends_after_a_section() {
    for ascii in [true, false] {
        for file in
            [splish(ascii), dual(ascii), toolkit(ascii)].into_iter().chain(with_ghosts(ascii))
        {
            for cut in 0..file.bytes.len() {
                let may_end = file.ends.contains(&cut);
                let [particles, mesh, _] = read_all(VTK, &file.bytes[..cut]);
                let end =
                    String::from_utf8_lossy(&file.bytes[cut.saturating_sub(40)..cut]).into_owned();
                assert_eq!(
                    particles.is_ok(),
                    may_end,
                    "ascii {ascii}, {cut} bytes, ending in {end:?}"
                );
                assert_eq!(mesh.is_ok(), may_end, "ascii {ascii}, {cut} bytes, ending in {end:?}");
            }
        }
    }
}

#[test]
fn huge_counts_are_refused_before_any_allocation() {
    let huge = [
        "2147483647",
        "4294967295",
        "9223372036854775808",
        "18446744073709551615",
        "99999999999999999999",
    ];
    let mut refused = 0;
    let mut refuse = |format: Format, file: &[u8], from: &str, to: &str| {
        let at = file.windows(from.len()).position(|w| w == from.as_bytes()).expect(from);
        let file = [&file[..at], to.as_bytes(), &file[at + from.len()..]].concat();
        let [particles, mesh, _] = read_all(format, &file);
        assert!(particles.is_err() || mesh.is_err(), "{from:?} as {to:?}");
        refused += 1;
    };
    for count in huge {
        for encoding in ENCODINGS {
            let file = ply_with_face(encoding);
            refuse(PLY, &file, "vertex 3", &format!("vertex {count}"));
            refuse(PLY, &file, "face 1", &format!("face {count}"));
            let fixed = format!("element a {count}\nproperty int b\nelement vertex");
            refuse(PLY, &file, "element vertex", &fixed);
            let lists = format!("element a {count}\nproperty list char int b\nelement vertex");
            refuse(PLY, &file, "element vertex", &lists);
        }
        for ascii in [true, false] {
            let file = splish(ascii).bytes;
            for line in [
                "POINTS 2 ",
                "CELLS 2 ",
                "CELLS 2 4",
                "CELL_TYPES 2",
                "POINT_DATA 2",
                "FieldData 2",
            ] {
                let (head, _) = line.trim_end().rsplit_once(' ').unwrap();
                let end = if line.ends_with(' ') { " " } else { "" };
                refuse(VTK, &file, line, &format!("{head} {count}{end}"));
            }
            refuse(VTK, &file, "velocity 3 2", &format!("velocity {count} 2"));
            refuse(VTK, &file, "velocity 3 2", &format!("velocity 3 {count}"));
            refuse(VTK, &file, "id unsigned_int 1", &format!("id unsigned_int {count}"));
            let file = toolkit(ascii).bytes;
            refuse(VTK, &file, "CELLS 3 2", &format!("CELLS {count} 2"));
            refuse(VTK, &file, "CELLS 3 2", &format!("CELLS 3 {count}"));
            refuse(VTK, &file, "names 1 2", &format!("names 1 {count}"));
            refuse(VTK, &file, "bits 1 2", &format!("bits 1 {count}"));
            refuse(VTK, &file, "table 1", &format!("table {count}"));
        }
    }
    assert_eq!(refused, huge.len() * (3 * 4 + 2 * 14));
}

#[test]
fn components_of_an_array_without_tuples_need_no_memory_or_time() {
    let head =
        "# vtk DataFile Version 5.1\nt\nBINARY\nDATASET POLYDATA\nPOINTS 0 float\n\nPOINT_DATA 0\n";
    let field = "FIELD FieldData 2\na 18446744073709551615 0 float\n\nb 9 0 float\n";
    let file = VTK.particles(format!("{head}{field}").as_bytes()).unwrap();
    assert_eq!(attributes(&file), [("b".to_owned(), 9, Vec::new())]);
    let names =
        "FIELD FieldData 1\na 18446744073709551615 0 float\n\nMETADATA\nCOMPONENT_NAMES\nx\n\n";
    assert!(VTK.particles(format!("{head}{names}").as_bytes()).is_err());
}
