//! Tests of files in which cells, not points, are flagged as ghosts: VTKHDF and legacy .vtk files
//! that VTK and h5py wrote.

use std::fs;
use std::path::Path;

use meniscus::internals::io::bytes::Unpacking;
use meniscus::internals::io::input::open_particles;
use meniscus::internals::io::wanted::WantedParticles;
use meniscus::internals::io::{ParticleFile, ReadError, ReadFault, h5};

use crate::common::files;
use crate::common::particle_files::{attribute, positions};
use crate::memory;

/// The steps of the files, each with its number of points and the points that are not ghosts.
const STEPS: [(u64, usize, &[usize]); 4] = [
    // Point 4 is a copy, 3 is refined and 1 is hidden. The flag of point 2 means high connectivity,
    // which does not make it a ghost.
    (0, 6, &[0, 2, 5]),
    // The partition of points 6 to 8 contains a line, so the flags of its cells are ignored. Two
    // vertex cells refer to point 10, and only one of them is flagged. No vertex cell refers to
    // point 12. None of these points is a ghost.
    (1, 7, &[6, 7, 8, 10, 12]),
    // This step has the cells of step 0, but different flags.
    (2, 6, &[1, 2, 3, 4]),
    // This step has the points and cells of step 0, as a separate partition.
    (3, 6, &[0, 2, 5]),
];

/// The name and the bytes of the file that contains all steps, for a kind of data set.
fn file_of_steps(kind: &str) -> (String, Vec<u8>) {
    let name = format!("flags_{kind}.vtkhdf");
    let bytes = fs::read(files::data("simulations").join(&name)).unwrap();
    (name, bytes)
}

fn read(bytes: &[u8], step: impl Into<Option<u64>>) -> Result<ParticleFile, ReadFault> {
    let (path, unpacking) = (Path::new("a.vtkhdf"), Unpacking::in_memory());
    let read = h5::open_particles(
        path,
        bytes.to_vec().into(),
        step.into(),
        WantedParticles::default(),
        unpacking,
    );
    read.map_err(|error| error.fault)
}

/// The identifiers of the remaining points, in file order.
fn ids(file: &ParticleFile) -> Vec<usize> {
    let ids: Vec<usize> = attribute(file, "id").iter().map(|&id| id as usize).collect();
    let points =
        open_particles(&files::data("simulations/points.csv"), Unpacking::in_memory()).unwrap();
    let points = positions(&points);
    for (found, &id) in positions(file).iter().zip(&ids) {
        assert!((0..3).all(|axis| (found[axis] - points[id][axis]).abs() < 1e-9), "point {id}");
    }
    ids
}

/// All offsets at which the file contains the bytes `from`. There must be at least one.
fn places(bytes: &[u8], from: &[u8]) -> Vec<usize> {
    let places: Vec<usize> =
        (0..=bytes.len() - from.len()).filter(|&at| bytes[at..].starts_with(from)).collect();
    assert!(!places.is_empty(), "{from:?} is not in the file");
    places
}

/// The file with every occurrence of `from` replaced by `to`.
fn replaced(bytes: &[u8], from: &[u8], to: &[u8]) -> Vec<u8> {
    assert_eq!(from.len(), to.len());
    let mut bytes = bytes.to_vec();
    places(&bytes, from).into_iter().for_each(|at| bytes[at..at + to.len()].copy_from_slice(to));
    bytes
}

fn longs(values: &[i64]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

#[test]
fn points_of_ghost_vertices_in_files_of_vtk_are_omitted() {
    let names = [
        "cells_poly_42.vtk",
        "cells_poly_51.vtk",
        "cells_grid_42.vtk",
        "cells_grid_51.vtk",
        "cells.vtkhdf",
    ];
    for name in names {
        let read = |unpacking| -> Result<ParticleFile, ReadError> {
            open_particles(&files::data("simulations").join(name), unpacking)
        };
        let file = read(Unpacking::in_memory()).unwrap();
        let left: Vec<usize> = (0..24).filter(|point| ![1, 5].contains(point)).collect();
        assert_eq!((ids(&file), file.ghosts), (left, 2), "{name}");
        let scratch = tempfile::tempdir().unwrap();
        let scratched =
            read(Unpacking { in_memory: 0, scratch: scratch.path(), control: None }).unwrap();
        assert_eq!(ids(&scratched), ids(&file), "{name} through scratch");
    }
}

#[test]
fn every_step_and_partition_uses_its_own_cells_and_ghost_flags() {
    for kind in ["poly", "grid"] {
        let (name, bytes) = file_of_steps(kind);
        for (step, all, left) in &STEPS[..if kind == "poly" { 4 } else { 3 }] {
            let file = read(&bytes, *step).unwrap();
            assert_eq!((&*ids(&file), file.ghosts), (*left, all - left.len()), "{name}#{step}");
        }
    }
}

#[test]
fn a_step_of_a_grid_is_a_mesh_only_if_one_of_its_own_cells_has_an_area() {
    let (_, bytes) = file_of_steps("grid");
    assert!(!h5::has_faces(bytes.clone().into()).unwrap());
    // The second step has a line, which is not a face.
    let types = [[1; 9].as_slice(), &[3], &[1; 5]].concat();
    let faces = |bytes: &[u8], step: u64| match read(bytes, step) {
        Ok(_) => 0,
        Err(ReadFault::Mesh { faces }) => faces,
        Err(fault) => panic!("{fault}"),
    };
    for (changed, of_steps) in [
        (&[(0, 5)][..], [1, 0, 1]),
        (&[(5, 10)], [1, 0, 1]),
        (&[(6, 12)], [0, 1, 0]),
        (&[(4, 7), (9, 9), (14, 42)], [1, 2, 1]),
    ] {
        let mut other = types.clone();
        changed.iter().for_each(|&(cell, kind)| other[cell] = kind);
        let bytes = replaced(&bytes, &types, &other);
        assert_eq!([0, 1, 2].map(|step| faces(&bytes, step)), of_steps, "{changed:?}");
        assert!(h5::has_faces(bytes.clone().into()).unwrap(), "{changed:?}");
        // Without `CellOffsets`, the cells of each step follow those of the previous step.
        let bytes = replaced(&bytes, b"\0CellData\0", b"\0~ellData\0");
        let bytes = replaced(&bytes, b"\0CellOffsets\0", b"\0~ellOffsets\0");
        assert_eq!([0, 1].map(|step| faces(&bytes, step)), of_steps[..2], "{changed:?}");
    }
}

#[test]
fn missing_cell_arrays_keep_all_points_and_steps_need_cell_offsets() {
    for kind in ["poly", "grid"] {
        let (_, bytes) = file_of_steps(kind);
        let without = |name: &str| {
            let name = format!("\0{name}\0");
            replaced(&bytes, name.as_bytes(), name.replacen(&name[1..2], "~", 1).as_bytes())
        };
        let mut lost = vec!["Offsets", "Connectivity", "NumberOfConnectivityIds", "CellData"];
        // If one of these data sets is missing, no point is a ghost. PolyData needs `Vertices`.
        lost.push(if kind == "poly" { "Vertices" } else { "NumberOfCells" });
        for name in lost {
            let file = read(&without(name), 0).unwrap();
            assert_eq!((ids(&file), file.ghosts), ((0..6).collect(), 0), "{kind} without {name}");
        }
        for name in ["CellOffsets", "ConnectivityIdOffsets"] {
            let fault = read(&without(name), 0).unwrap_err();
            assert!(
                matches!(fault, ReadFault::Malformed { .. }) && fault.to_string().contains(name),
                "{fault}"
            );
        }
        // Without offsets of cell data, the flags of the first step apply. Without flags, no point
        // is a ghost.
        for name in ["CellDataOffsets", "vtkGhostType"] {
            let file = read(&without(name), 2).unwrap();
            let left: &[usize] =
                if name == "vtkGhostType" { &[0, 1, 2, 3, 4, 5] } else { &[0, 2, 5] };
            assert_eq!(ids(&file), left, "{kind} without {name}");
        }
    }
    // Without cell types, the cells' offsets show that each cell has one point.
    let (_, bytes) = file_of_steps("grid");
    let file = read(&replaced(&bytes, b"\0Types\0", b"\0~ypes\0"), 0).unwrap();
    assert_eq!(ids(&file), [0, 2, 5]);
    // Flags do not apply to a cell that has one point but is not a vertex.
    let types = [[1; 9].as_slice(), &[3], &[1; 5]].concat();
    for (at, left) in [(0, &[0, 1, 2, 3, 4, 5][..]), (6, &[0, 2, 5])] {
        let mut other = types.clone();
        other[at] = 2;
        assert_eq!(ids(&read(&replaced(&bytes, &types, &other), 0).unwrap()), left, "cell {at}");
    }
}

#[test]
fn invalid_cell_counts_and_indices_are_reported_with_their_partition() {
    let (_, bytes) = file_of_steps("grid");
    let counts = |cells: i64| longs(&[6, 0, 4, cells, 6]);
    let ids_of = |ids: i64| longs(&[6, 0, 5, ids, 6]);
    // The point numbers of the cells in the third and the fourth partition.
    let corners = |last: i64| longs(&[0, 1, 2, 0, 1, 0, 1, 1, 2, last]);
    let data = |of_step: i64| longs(&[0, of_step, 15]);
    let first = |cell: i64| longs(&[0, cell, 0]);
    for (from, to, message) in [
        (corners(2), corners(4), "partition 3: cell 4 refers to point 4, but there are 5 cells"),
        (corners(2), corners(-1), "partition 3: cell 4 refers to point -1, but there are 5 cells"),
        (ids_of(5), ids_of(4), "partition 3: 5 cells refer to 4 points"),
        (
            ids_of(5),
            ids_of(6),
            "partition 3: Connectivity has only 5 of the 6 numbers of this partition",
        ),
        (ids_of(5), ids_of(-1), "NumberOfConnectivityIds contains -1"),
        (ids_of(5), ids_of(1 << 62), "too many for the size"),
        (
            counts(5),
            counts(6),
            "partition 3: Offsets has only 6 of the 7 numbers of this partition",
        ),
        (counts(5), counts(-1), "NumberOfCells contains -1"),
        (counts(5), counts(1 << 62), "too many for the size"),
        (
            data(6),
            data(13),
            "partition 3: vtkGhostType has only 4 of the 5 numbers of this partition",
        ),
        (
            data(6),
            data(i64::MAX),
            "partition 3: vtkGhostType has only 0 of the 5 numbers of this partition",
        ),
    ] {
        let damaged = replaced(&bytes, &from, &to);
        let (result, largest) = memory::largest_allocation(|| read(&damaged, 1));
        let fault = result.expect_err(message).to_string();
        assert!(fault.contains(message), "{fault} instead of {message}");
        assert!(largest < 1 << 20, "{largest} bytes for: {fault}");
    }
    // Damage each occurrence of `from` in turn, and return the errors.
    let faults = |bytes: &[u8], from: &[u8], to: &[u8], step: Option<u64>| -> Vec<String> {
        let damaged = places(bytes, from).into_iter().map(|at| {
            let mut damaged = bytes.to_vec();
            damaged[at..at + to.len()].copy_from_slice(to);
            read(&damaged, step)
        });
        damaged.filter_map(|read| read.err().map(|fault| fault.to_string())).collect()
    };
    for (cell, message) in [
        (1 << 40, "partition 2: Offsets has only 0 of the 5 numbers of this partition"),
        (1 << 40, "partition 3: Connectivity has only 0 of the 5 numbers of this partition"),
        (-6, "CellOffsets contains -6"),
        (-6, "ConnectivityIdOffsets contains -6"),
    ] {
        let found = faults(&bytes, &first(6), &first(cell), Some(1));
        assert!(found.iter().any(|fault| fault.contains(message)), "{found:?} without {message}");
    }
    // If the offsets do not give each cell one point, no point is a ghost.
    let ends = |last: i64| longs(&[5, 0, 1, 2, 3, 4, last]);
    let file = read(&replaced(&bytes, &ends(5), &ends(6)), 1).unwrap();
    assert_eq!(ids(&file), (6..13).collect::<Vec<_>>());
    // In a file without steps, every flag belongs to a cell.
    let whole = fs::read(files::data("simulations/cells.vtkhdf")).unwrap();
    let [right, wrong] = [24, 23].map(|count| longs(&[count]));
    // The number of cells and the number of their points must agree.
    let damaged = places(&whole, &right).into_iter().flat_map(|at| {
        let mut damaged = whole.clone();
        damaged[at..at + 8].copy_from_slice(&wrong);
        faults(&damaged, &right, &wrong, None)
    });
    let damaged: Vec<String> = damaged.collect();
    let message = "vtkGhostType must have one number for each of 23 cells";
    assert!(damaged.iter().any(|fault| fault.contains(message)), "{damaged:?}");
}

#[test]
fn damaged_files_cause_neither_panics_nor_large_allocations() {
    for (kind, step) in [("poly", 1), ("poly", 3), ("grid", 1)] {
        let (name, whole) = file_of_steps(kind);
        let values = positions(&read(&whole, step).unwrap());
        let read = |bytes: &[u8]| {
            let (result, largest) = memory::largest_allocation(|| read(bytes, step));
            // Reading an uncompressed file never needs a block of memory larger than 64 MiB.
            assert!(largest <= 64 << 20, "{name}: {largest} bytes");
            result.map(|file| positions(&file))
        };
        for length in 0..whole.len() {
            // A truncated file may be valid if only padding is missing.
            if let Ok(found) = read(&whole[..length]) {
                assert_eq!(found, values, "{name} cut at {length}");
            }
        }
        for at in 0..whole.len() {
            let mut bytes = whole.clone();
            bytes[at] ^= [0x01, 0x80, 0xff][at % 3];
            let _ = read(&bytes);
        }
    }
}
