//! VTKHDF: the points of PolyData and UnstructuredGrid, their partitions one after the other, and the polygons of PolyData.
//!
//! Steps lie one after the other in every data set; `Steps` says where each begins.

use hdf5_reader::group::Group;

use crate::io::vertices::{Triangles, mesh_of};
use crate::io::wanted::WantedAttributes;
use crate::io::{ParticleFile, ReadFault, malformed, vtp};
use crate::particles::Particles;
use crate::surface::mesh::Mesh;

use super::file::{File, checked, time_of};
use super::steps::a_sequence;
use super::table::{Array, Table};

/// Name of the group that all is in.
pub const ROOT: &str = "VTKHDF";
const POLY_DATA: &str = "PolyData";

/// The rows that belong to a frame.
struct Frame {
    /// The number of the step, where there are steps.
    step: Option<u64>,
    /// Partitions, from the first on.
    parts: [u64; 2],
    /// Row of the first point.
    point: u64,
}

/// The group that all is in, and the type of its data set.
fn opened(file: &File) -> Result<(Group, String), ReadFault> {
    let root = file.group(ROOT)?;
    let kind = checked(root.attribute("Type").and_then(|kind| kind.read_string()))?;
    match kind.as_str() {
        POLY_DATA | "UnstructuredGrid" => Ok((root, kind)),
        _ => {
            let what = "points are read from PolyData and UnstructuredGrid";
            Err(ReadFault::Unsupported(format!("a data set of type {kind:?}; {what}")))
        }
    }
}

fn sub_group(root: &Group, name: &str) -> Result<Option<Group>, ReadFault> {
    let (groups, _) = checked(root.member_names())?;
    let there = groups.iter().any(|group| group == name);
    there.then(|| checked(root.group(name))).transpose()
}

fn integers(file: &File, group: &Group, name: &str) -> Result<Vec<i64>, ReadFault> {
    Array::named(group, name)?.integers(file)
}

/// A number that counts something.
fn count(value: i64, name: &str) -> Result<u64, ReadFault> {
    u64::try_from(value).map_err(|_| malformed(0, format!("{value} in {name}")))
}

/// Entry number `index` of a data set of counts.
fn entry(file: &File, group: &Group, name: &str, index: u64) -> Result<u64, ReadFault> {
    let array = Array::named(group, name)?;
    match array.part(index, 1)?.integers(file)?.first() {
        Some(&value) => count(value, name),
        None => Err(malformed(0, format!("{name} has no entries"))),
    }
}

/// The number of steps; `None` of a file without.
fn step_count(root: &Group) -> Result<Option<u64>, ReadFault> {
    let Some(steps) = sub_group(root, "Steps")? else { return Ok(None) };
    let values = Array::named(&steps, "Values")?;
    Ok(Some(values.rows))
}

/// The numbers of the steps; none in a file that is one frame.
pub fn steps(file: &File) -> Result<Vec<u64>, ReadFault> {
    let (root, _) = opened(file)?;
    let steps = step_count(&root)?.unwrap_or(0);
    if steps.saturating_mul(8) > file.limit {
        return Err(ReadFault::Compression(format!("{steps} steps are beyond all reason for this file")));
    }
    Ok((0..steps).collect())
}

impl Frame {
    fn of(file: &File, root: &Group, step: Option<u64>) -> Result<Self, ReadFault> {
        let all = Array::named(root, "NumberOfPoints")?.rows;
        let step = match (step, step_count(root)?) {
            (None, None) => return Ok(Self { step: None, parts: [0, all], point: 0 }),
            (None, Some(1)) => 0,
            (Some(step), Some(steps)) if step < steps => step,
            (None, Some(steps)) if steps > 1 => return Err(a_sequence(0, steps - 1)),
            (step, _) => {
                let step = step.map_or("steps at all".to_owned(), |step| format!("step {step}"));
                return Err(ReadFault::Unsupported(format!("there is no {step}")));
            }
        };
        let steps = checked(root.group("Steps"))?;
        let at = |name: &str| entry(file, &steps, name, step);
        let first = at("PartOffsets")?;
        let (_, sets) = checked(steps.member_names())?;
        let parts = if sets.iter().any(|set| set == "NumberOfParts") { at("NumberOfParts")? } else { 1 };
        let end = first.checked_add(parts).filter(|end| *end <= all);
        let end = end.ok_or_else(|| malformed(0, format!("{parts} parts from {first} on of {all}")))?;
        Ok(Self { step: Some(step), parts: [first, end], point: at("PointOffsets")? })
    }

    /// Numbers of points of the partitions.
    fn points(&self, file: &File, root: &Group) -> Result<Vec<u64>, ReadFault> {
        self.of_parts(file, root, "NumberOfPoints", 0)
    }

    /// The entries of a data set for every partition, each with so many behind it that are taken too.
    fn of_parts(&self, file: &File, group: &Group, name: &str, more: u64) -> Result<Vec<u64>, ReadFault> {
        let [first, end] = self.parts;
        let part = Array::named(group, name)?.part(first, end - first + more)?;
        part.integers(file)?.into_iter().map(|value| count(value, name)).collect()
    }

    /// The columns of the points.
    fn table(&self, file: &File, root: &Group) -> Result<Table, ReadFault> {
        let rows = sum(&self.points(file, root)?)?;
        let mut arrays = vec![Array::named(root, "Points")?.part(self.point, rows)?];
        if let Some(data) = sub_group(root, "PointData")? {
            let offsets = match self.step {
                None => None,
                Some(_) => sub_group(&checked(root.group("Steps"))?, "PointDataOffsets")?,
            };
            for array in Array::all_of(&data)? {
                let first = match (&offsets, self.step) {
                    (Some(offsets), Some(step)) => entry(file, offsets, &array.name, step)?,
                    _ => self.point,
                };
                arrays.push(array.part(first, rows)?);
            }
        }
        let no_points = || malformed(0, "the Points have not three components");
        Table::of_arrays(arrays, "Points").ok_or_else(no_points)
    }

    fn time(&self, file: &File, root: &Group) -> Result<Option<f64>, ReadFault> {
        let Some(step) = self.step else { return Ok(time_of(root)) };
        let values = Array::named(&checked(root.group("Steps"))?, "Values")?.part(step, 1)?;
        values.check_small(file)?;
        Ok(values.doubles([0, 1])?.first().copied().filter(|time| time.is_finite()))
    }
}

fn sum(counts: &[u64]) -> Result<u64, ReadFault> {
    let sum = counts.iter().try_fold(0u64, |sum, &count| sum.checked_add(count));
    sum.ok_or_else(|| malformed(0, "more points than can be counted"))
}

/// Reads the points as particles, where no faces are made of them.
pub fn read_particles(
    file: File,
    step: Option<u64>,
    wanted: WantedAttributes,
) -> Result<ParticleFile, ReadFault> {
    let (root, kind) = opened(&file)?;
    let faces = if kind == POLY_DATA { faces(&file, &root)? } else { 0 };
    if faces > 0 {
        return Err(ReadFault::Mesh { faces });
    }
    let frame = Frame::of(&file, &root, step)?;
    let time = frame.time(&file, &root)?;
    let table = frame.table(&file, &root)?;
    drop(root);
    let format = if kind == POLY_DATA { "VTKHDF PolyData" } else { "VTKHDF UnstructuredGrid" };
    Ok(ParticleFile { time, ..table.read(file, format, wanted)? })
}

/// Polygons and strips of all partitions and steps.
fn faces(file: &File, root: &Group) -> Result<u64, ReadFault> {
    let mut faces = 0;
    for cells in ["Polygons", "Strips"] {
        let Some(group) = sub_group(root, cells)? else { continue };
        for cells in integers(file, &group, "NumberOfCells")? {
            faces = sum(&[faces, count(cells, "NumberOfCells")?])?;
        }
    }
    Ok(faces)
}

/// Whether there are polygons or strips, or nothing at all.
pub fn has_faces(file: &File) -> Result<bool, ReadFault> {
    let (root, kind) = opened(file)?;
    if kind != POLY_DATA {
        return Ok(false);
    }
    if faces(file, &root)? > 0 {
        return Ok(true);
    }
    Ok(integers(file, &root, "NumberOfPoints")?.iter().all(|&points| points == 0))
}

/// Reads the polygons of all partitions.
pub fn read_mesh(file: File) -> Result<Mesh, ReadFault> {
    let (root, kind) = opened(&file)?;
    if kind != POLY_DATA {
        return Err(ReadFault::Unsupported(format!("an {kind}; a mesh is {POLY_DATA}")));
    }
    let frame = Frame::of(&file, &root, None)?;
    if frame.step.is_some() {
        return Err(ReadFault::Unsupported("steps in time; a mesh is one frame".to_owned()));
    }
    let points = frame.points(&file, &root)?;
    if let Some(strips) = sub_group(&root, "Strips")?
        && sum(&frame.of_parts(&file, &strips, "NumberOfCells", 0)?)? > 0
    {
        return Err(ReadFault::Unsupported("triangle strips; save them as triangles".to_owned()));
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

/// Adds the polygons of all partitions, whose corners are numbered in each from its own first point.
fn add_polygons(
    file: &File,
    frame: &Frame,
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
        let short =
            || malformed(0, format!("{cells} polygons with {ids} corners are announced, and not there"));
        let end = |start: usize, count: u64| start.checked_add(usize::try_from(count).ok()?);
        let ends = end(at, cells).and_then(|last| offsets.get(at..=last)).ok_or_else(short)?;
        let own = end(corner, ids).and_then(|last| connectivity.get(corner..last)).ok_or_else(short)?;
        for pair in ends.windows(2) {
            let range = usize::try_from(pair[0]).ok().zip(usize::try_from(pair[1]).ok());
            let polygon = range.and_then(|(start, end)| own.get(start..end)).ok_or_else(|| {
                malformed(0, format!("polygon {face} has no corners from {} to {}", pair[0], pair[1]))
            })?;
            if let Some(wrong) = polygon.iter().find(|&&corner| corner < 0 || corner as u64 >= *points) {
                return Err(malformed(0, format!("polygon {face} names point {wrong} of {points}")));
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
