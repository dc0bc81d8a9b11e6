//! Reading .vtp and .vtu files: the points and their attributes as columns, polygons as triangles.

use std::ops::Range;

use memchr::memmem;

use crate::io::bytes::{Bytes, Unpacking, View, unpacked_limit};
use crate::io::columns::{Column, Scalar};
use crate::io::ghosts::{VERTEX, VertexCells, VertexPoints, is_flag};
use crate::io::vertices::{Triangles, Vertices};
use crate::io::wanted::GHOSTS;
use crate::io::{ParticleFile, ReadFault, malformed};
use crate::particles::AttributeInfo;
use crate::surface::mesh::Mesh;

use super::NORMALS;
use super::data::Decoder;
use super::layout::{Array, DataSet, HEAD, Layout, Section, TIME};

/// Reads the points as particles, whatever lines and cells of a .vtu are made of them: arrays that
/// are appended raw stay where they are; if any is text, base64 or compressed, all are decoded.
///
/// Every array of numbers under `PointData` is an attribute; `TimeValue` under `FieldData` is the
/// time. Points that are copies, or hidden, because their vertices are flagged so under `CellData`
/// are left out.
///
/// # Errors
/// [`ReadFault::Mesh`] where there are polygons; [`ReadFault::Truncated`] and
/// [`ReadFault::Malformed`] for damage, [`ReadFault::Compression`] for data that do not unpack, or
/// unpack beyond all reason; [`ReadFault::Unsupported`] for other compressors than zlib, several
/// pieces, and other data sets than PolyData and UnstructuredGrid; [`ReadFault::Scratch`] where
/// they are decoded into a scratch file that fails.
pub fn read_particles(bytes: Bytes, unpacking: Unpacking) -> Result<ParticleFile, ReadFault> {
    let view = bytes.view();
    let stays = !is_text(view)? && Decoder::all_in_place(&Layout::parse(view)?);
    points(if stays { bytes } else { Bytes::Kept(bytes.read_whole(unpacking)?) }, unpacking)
}

/// Whether all has to be read to find what is where: there are texts in the XML, or what is behind
/// it is encoded or compressed.
///
/// # Errors
/// [`ReadFault::Changed`] and [`ReadFault::Io`] where the file cannot be read.
pub fn is_text(bytes: View) -> Result<bool, ReadFault> {
    let head = bytes.read(0..bytes.len().min(HEAD))?;
    let has = |text: &[u8]| memmem::find(&head, text).is_some();
    Ok(!has(b"encoding=\"raw\"") || has(b"compressor="))
}

/// The bytes where they are, or in memory as a whole where all has to be read.
pub(in crate::io) fn unless_text(bytes: Bytes) -> Result<Bytes, ReadFault> {
    if is_text(bytes.view())? {
        bytes.read_whole(Unpacking::in_memory()).map(Bytes::Kept)
    } else {
        Ok(bytes)
    }
}

fn points(bytes: Bytes, unpacking: Unpacking) -> Result<ParticleFile, ReadFault> {
    let layout = Layout::parse(bytes.view())?;
    let faces = layout.polygons.saturating_add(layout.strips) as u64;
    if faces > 0 {
        return Err(ReadFault::Mesh { faces });
    }
    let format = match layout.data_set {
        DataSet::PolyData => "VTK XML .vtp",
        DataSet::UnstructuredGrid => "VTK XML .vtu",
    };
    let mut decoder = Decoder::new(&layout, unpacking);
    let time = time(&layout, &mut decoder)?;
    let left = not_ghosts(&layout, &mut decoder)?;
    let vertices = vertices(&layout, decoder, None)?;
    Ok(ParticleFile { time, ..vertices.into_particles(bytes, format) }.with_points(left))
}

/// Whether there are polygons, so that the file is a mesh rather than particles; a file of nothing
/// at all is one.
pub fn has_faces(bytes: View) -> Result<bool, ReadFault> {
    let Counts { points, faces } = counts(bytes)?;
    Ok(points == 0 || faces > 0)
}

/// Numbers of points, and of polygons and strips together.
pub(super) struct Counts {
    pub points: usize,
    pub faces: usize,
}

pub(super) fn counts(bytes: View) -> Result<Counts, ReadFault> {
    let Layout { points, polygons, strips, .. } = Layout::parse(bytes)?;
    Ok(Counts { points, faces: polygons.saturating_add(strips) })
}

/// Reads points, their attributes, and polygons, fanned from their first corner.
///
/// Vertices, lines and the data of cells are passed over.
///
/// # Errors
/// As [`read_particles`]; besides [`ReadFault::Unsupported`] for triangle strips and an
/// UnstructuredGrid.
pub fn read_mesh(bytes: &[u8]) -> Result<Mesh, ReadFault> {
    Ok(read_numbered(bytes)?.mesh)
}

/// A mesh, and the identifiers that its vertices share with those of other pieces.
pub(super) struct NumberedMesh {
    pub mesh: Mesh,
    pub numbers: Option<Vec<i64>>,
}

/// Reads a mesh that may be a piece of another.
pub(super) fn read_numbered(bytes: &[u8]) -> Result<NumberedMesh, ReadFault> {
    let layout = Layout::parse(bytes.into())?;
    if layout.data_set != DataSet::PolyData {
        return Err(ReadFault::Unsupported("an UnstructuredGrid; a mesh is PolyData".to_owned()));
    }
    if layout.strips > 0 {
        return Err(ReadFault::Unsupported("triangle strips; save them as triangles".to_owned()));
    }
    let mut decoder = Decoder::new(&layout, Unpacking::in_memory());
    let mut integers = |name: &str| {
        let found = layout.arrays.iter().find(|a| a.section == Section::Polys && a.name == name);
        found.map_or(Ok(Vec::new()), |array| decoder.integers(array))
    };
    let corners = integers("connectivity")?;
    let ends = integers("offsets")?;
    if ends.len() != layout.polygons {
        let what =
            format!("{} polygons are announced, {} have an offset", layout.polygons, ends.len());
        return Err(malformed(0, what));
    }
    let ids = layout.global_ids.as_ref().and_then(|ids| {
        let is_it = |array: &Array| array.section == Section::PointData && array.name == *ids;
        layout.arrays.iter().position(is_it)
    });
    let numbers = ids.map(|index| decoder.integers(&layout.arrays[index])).transpose()?;
    if numbers.as_ref().is_some_and(|numbers| numbers.len() != layout.points) {
        return Err(malformed(
            0,
            format!("not one global identifier for each of {} points", layout.points),
        ));
    }
    let mut triangles = Triangles::new(layout.points)?;
    let mut start = 0;
    for (face, &end) in ends.iter().enumerate() {
        let polygon = usize::try_from(end).ok().and_then(|end| corners.get(start..end));
        let polygon = polygon.ok_or_else(|| {
            malformed(0, format!("polygon {face} has no corners from {start} to {end}"))
        })?;
        triangles.polygon(face, 0, polygon)?;
        start += polygon.len();
    }
    let vertices = vertices(&layout, decoder, ids)?;
    Ok(NumberedMesh { mesh: vertices.into_mesh(bytes, triangles.triangles), numbers })
}

fn time(layout: &Layout, decoder: &mut Decoder) -> Result<Option<f64>, ReadFault> {
    let found = layout.arrays.iter().find(|a| a.section == Section::FieldData && a.name == TIME);
    let Some(array) = found else { return Ok(None) };
    Ok(decoder.double(array)?.filter(|time| time.is_finite()))
}

/// The points and all of their attributes but for array number `except`.
fn vertices(
    layout: &Layout,
    mut decoder: Decoder,
    except: Option<usize>,
) -> Result<Vertices, ReadFault> {
    let (count, endian) = (layout.points, layout.endian);
    if count == 0 {
        let nowhere = Column { offset: 0, stride: 0, scalar: Scalar::F32, endian };
        let attributes = Vec::new();
        return Ok(Vertices {
            decoded: None,
            count,
            position: [nowhere; 3],
            attributes,
            normals: None,
        });
    }
    let is_of_points = |section| matches!(section, Section::Points | Section::PointData);
    let others = layout.arrays.iter().enumerate().filter(|(index, _)| Some(*index) != except);
    let arrays: Vec<_> =
        others.map(|(_, array)| array).filter(|a| is_of_points(a.section)).collect();
    let is_normals = |name: &str| name == layout.normals.as_deref().unwrap_or(NORMALS);
    let (mut position, mut normals) = (None, None);
    let mut attributes = Vec::new();
    for (array, columns) in arrays.iter().zip(decoder.columns(&arrays)?) {
        if array.section == Section::Points {
            position = <[Column; 3]>::try_from(columns).ok();
            continue;
        }
        if columns.len() == 3 && normals.is_none() && is_normals(&array.name) {
            normals = Some(attributes.len());
        }
        attributes
            .push((AttributeInfo { name: array.name.clone(), components: columns.len() }, columns));
    }
    let position =
        position.ok_or_else(|| malformed(0, "no array of points of three components"))?;
    Ok(Vertices { decoded: decoder.finish()?, count, position, attributes, normals })
}

/// Ranges of the points that are not left out for their cells; `None` where all are to stay.
pub(super) fn not_ghosts(
    layout: &Layout,
    decoder: &mut Decoder,
) -> Result<Option<Vec<Range<usize>>>, ReadFault> {
    let found = |section: Section, name: &str| {
        layout.arrays.iter().find(|array| array.section == section && array.name == name)
    };
    let (section, cells) = match layout.data_set {
        // Other cells than vertices come after these.
        DataSet::PolyData => (Section::Verts, layout.vertices),
        DataSet::UnstructuredGrid => (Section::Cells, layout.cells),
    };
    let flags = GHOSTS.iter().filter_map(|name| found(Section::CellData, name));
    let flags: Vec<&Array> =
        flags.filter(|array| is_flag(&array.name, array.components, array.scalar)).collect();
    let corners = [found(section, "connectivity"), found(section, "offsets")];
    let ([Some(corners), Some(ends)], false) = (corners, flags.is_empty() || layout.lines > 0)
    else {
        return Ok(None);
    };
    // Whoever reads the points refuses more of them than the file can hold.
    if layout.points as u64 > unpacked_limit(layout.bytes.len() as u64) {
        return Ok(None);
    }
    let (mut all_vertices, mut count) = (true, 0);
    decoder.each_integer(ends, |cell, end| {
        all_vertices &= end == cell as i64 + 1;
        count = cell + 1;
    })?;
    if count != cells {
        return Err(malformed(
            ends.place(),
            format!("{cells} cells are announced, {count} have an offset"),
        ));
    }
    if let (DataSet::UnstructuredGrid, Some(types)) = (layout.data_set, found(section, "types")) {
        decoder.each_integer(types, |_, kind| all_vertices &= kind == VERTEX)?;
    }
    if !all_vertices {
        return Ok(None);
    }
    let mut vertices = VertexCells::new(cells);
    for array in flags {
        let mut flags = vertices.flags(&array.name);
        decoder.each_integer(array, |cell, flag| flags.take(cell, flag))?;
        flags.end().map_err(|what| malformed(array.place(), what))?;
    }
    let mut points = VertexPoints::new(&vertices, layout.points);
    decoder.each_integer(corners, |cell, point| points.take(cell, point))?;
    points.left().map(Some).map_err(|what| malformed(corners.place(), what))
}
