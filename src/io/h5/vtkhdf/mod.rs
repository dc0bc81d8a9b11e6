//! Reads VTKHDF: the points of PolyData and UnstructuredGrid, partition by partition, and the
//! polygons of PolyData.
//!
//! Every data set contains the rows of all steps, one step after another. The group `Steps`
//! contains the start of each step.

mod frame;
mod ghosts;

use hdf5_reader::group::Group;

use crate::io::cell_types::is_face;
use crate::io::vertices::{Triangles, mesh_of};
use crate::io::wanted::WantedAttributes;
use crate::io::{ParticleFile, ReadFault, malformed, vtp};
use crate::particles::Particles;
use crate::surface::mesh::Mesh;

use super::file::{H5File, convert_error};
use super::table::H5Array;

use frame::{FrameRows, count, integers, step_count, sub_group, sum};
use ghosts::CellLayout;

/// Name of the group that contains all data.
pub const ROOT: &str = "VTKHDF";
const POLY_DATA: &str = "PolyData";

/// The group that contains all data, and the type of the data set.
fn root_and_type(file: &H5File) -> Result<(Group, String), ReadFault> {
    let root = file.group(ROOT)?;
    let kind = convert_error(root.attribute("Type").and_then(|kind| kind.read_string()))?;
    match kind.as_str() {
        POLY_DATA | "UnstructuredGrid" => Ok((root, kind)),
        _ => {
            let what = "is not supported, only PolyData and UnstructuredGrid";
            Err(ReadFault::Unsupported(format!("a data set of type {kind:?} {what}")))
        }
    }
}

/// The numbers of the steps. Empty for a file with a single frame.
pub fn steps(file: &H5File) -> Result<Vec<u64>, ReadFault> {
    let (root, _) = root_and_type(file)?;
    let steps = step_count(&root)?.unwrap_or(0);
    if steps.saturating_mul(8) > file.limit {
        return Err(ReadFault::Compression(format!(
            "{steps} steps are too many for the size of this file"
        )));
    }
    Ok((0..steps).collect())
}

/// Reads the points as particles. Returns [`ReadFault::Mesh`] if the frame of an UnstructuredGrid
/// has a cell with an area or a volume, or if PolyData has polygons or strips in any frame. In a
/// partition that has only vertex cells, a point is left out if all of its cells are flagged as
/// copied, refined or hidden.
pub fn read_particles(
    file: H5File,
    step: Option<u64>,
    wanted: WantedAttributes,
) -> Result<ParticleFile, ReadFault> {
    let (root, kind) = root_and_type(&file)?;
    refuse_mesh(if kind == POLY_DATA { faces(&file, &root)? } else { 0 })?;
    let frame = FrameRows::of(&file, &root, step)?;
    if kind != POLY_DATA
        && let Some(types) = frame.cell_types(&file, &root)?
    {
        refuse_mesh(typed_faces(&types).sum::<Result<u64, ReadFault>>()?)?;
    }
    let time = frame.time(&file, &root)?;
    let table = frame.table(&file, &root)?;
    let (cells, format) = match kind == POLY_DATA {
        true => (CellLayout::ByKind, "VTKHDF PolyData"),
        false => (CellLayout::Typed, "VTKHDF UnstructuredGrid"),
    };
    let non_ghosts = ghosts::non_ghost_points(&file, &root, &frame, cells)?;
    let mut left_out = ghosts::other_cell_data(&root)?;
    drop(root);
    let file = table.read(file, format, wanted)?;
    left_out.extend(file.left_out);
    Ok(ParticleFile { time, left_out, ..file }.with_points(non_ghosts))
}

fn refuse_mesh(faces: u64) -> Result<(), ReadFault> {
    if faces > 0 { Err(ReadFault::Mesh { faces }) } else { Ok(()) }
}

/// The number of cells with an area or a volume in each window of `types` (a range of rows that is
/// read at once). The caller adds these numbers up.
fn typed_faces(types: &H5Array) -> impl Iterator<Item = Result<u64, ReadFault>> {
    let windows = types.windows();
    (0..windows.count).map(move |window| {
        let kinds = types.some_integers(windows.rows(window, types.rows))?;
        Ok(kinds.into_iter().filter(|&kind| is_face(kind)).count() as u64)
    })
}

/// The total number of polygons and strips in all partitions and steps.
fn faces(file: &H5File, root: &Group) -> Result<u64, ReadFault> {
    let mut faces = 0;
    for cells in ["Polygons", "Strips"] {
        let Some(group) = sub_group(root, cells)? else { continue };
        for cells in integers(file, &group, "NumberOfCells")? {
            faces = sum(&[faces, count(cells, "NumberOfCells")?])?;
        }
    }
    Ok(faces)
}

/// Whether the file contains a mesh: a cell has an area or a volume, or PolyData has no points.
pub fn has_faces(file: &H5File) -> Result<bool, ReadFault> {
    let (root, kind) = root_and_type(file)?;
    if kind != POLY_DATA {
        let types = FrameRows::all(&root)?.cell_types(file, &root)?;
        let Some(types) = types else { return Ok(false) };
        for faces in typed_faces(&types) {
            if faces? > 0 {
                return Ok(true);
            }
        }
        return Ok(false);
    }
    if faces(file, &root)? > 0 {
        return Ok(true);
    }
    Ok(integers(file, &root, "NumberOfPoints")?.iter().all(|&points| points == 0))
}

/// Reads the polygons of all partitions as one mesh.
pub fn read_mesh(file: H5File) -> Result<Mesh, ReadFault> {
    let (root, kind) = root_and_type(&file)?;
    if kind != POLY_DATA {
        return Err(ReadFault::Unsupported(format!(
            "the file contains an {kind}, but meshes must be {POLY_DATA}"
        )));
    }
    let frame = FrameRows::of(&file, &root, None)?;
    if frame.step.is_some() {
        return Err(ReadFault::Unsupported(
            "the file contains several time steps, but a mesh must be a single frame".to_owned(),
        ));
    }
    let points = frame.points(&file, &root)?;
    if let Some(strips) = sub_group(&root, "Strips")?
        && sum(&frame.of_parts(&file, &strips, "NumberOfCells", 0)?)? > 0
    {
        return Err(ReadFault::Unsupported(
            "triangle strips are not supported; save them as triangles".to_owned(),
        ));
    }
    let mut triangles = Triangles::new(usize::try_from(sum(&points)?).unwrap_or(usize::MAX))?;
    if let Some(polygons) = sub_group(&root, "Polygons")? {
        add_polygons(&file, &frame, &polygons, &points, &mut triangles)?;
    }
    let table = frame.table(&file, &root)?;
    drop(root);
    let file = table.read(file, "VTKHDF", WantedAttributes::All)?;
    let mesh = mesh_of(&file.particles, vtp::NORMALS, triangles.triangles);
    file.particles.check().map_err(|_| ReadFault::Changed)?;
    Ok(mesh)
}

/// Adds the triangles of the polygons of all partitions. In the file, a corner is the index of a
/// point, counted from the partition's first point.
fn add_polygons(
    file: &H5File,
    frame: &FrameRows,
    polygons: &Group,
    points: &[u64],
    triangles: &mut Triangles,
) -> Result<(), ReadFault> {
    let cells = frame.of_parts(file, polygons, "NumberOfCells", 0)?;
    let ids = frame.of_parts(file, polygons, "NumberOfConnectivityIds", 0)?;
    let (offsets, connectivity) =
        (integers(file, polygons, "Offsets")?, integers(file, polygons, "Connectivity")?);
    let (mut at, mut corner, mut base, mut face) = (0usize, 0usize, 0i64, 0);
    for ((cells, ids), points) in cells.into_iter().zip(ids).zip(points) {
        let short = || {
            malformed(
                0,
                format!(
                    "the arrays Offsets and Connectivity are too short for {cells} polygons with \
                     {ids} corners"
                ),
            )
        };
        let end = |start: usize, count: u64| start.checked_add(usize::try_from(count).ok()?);
        let ends = end(at, cells).and_then(|last| offsets.get(at..=last)).ok_or_else(short)?;
        let own =
            end(corner, ids).and_then(|last| connectivity.get(corner..last)).ok_or_else(short)?;
        for pair in ends.windows(2) {
            let range = usize::try_from(pair[0]).ok().zip(usize::try_from(pair[1]).ok());
            let polygon = range.and_then(|(start, end)| own.get(start..end)).ok_or_else(|| {
                malformed(
                    0,
                    format!(
                        "the range of corners {} to {} of polygon {face} is invalid",
                        pair[0], pair[1]
                    ),
                )
            })?;
            if let Some(wrong) =
                polygon.iter().find(|&&corner| corner < 0 || corner as u64 >= *points)
            {
                return Err(malformed(
                    0,
                    format!(
                        "polygon {face} refers to point {wrong}, but there are {points} points"
                    ),
                ));
            }
            let moved: Vec<i64> = polygon.iter().map(|corner| corner + base).collect();
            triangles.polygon(face, 0, &moved)?;
            face += 1;
        }
        at += ends.len();
        corner += own.len();
        base += *points as i64;
    }
    Ok(())
}
