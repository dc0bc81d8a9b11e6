//! Reading .vtp and .vtu files: the points and their attributes as columns, polygons as triangles.

use crate::io::bytes::{Bytes, Unpacking};
use crate::io::columns::{Column, Scalar};
use crate::io::vertices::{Triangles, Vertices};
use crate::io::{ParticleFile, ReadFault, malformed};
use crate::particles::AttributeInfo;
use crate::surface::mesh::Mesh;

use super::NORMALS;
use super::data::Decoder;
use super::layout::{DataSet, Layout, Section, TIME};

/// Reads the points as particles, whatever lines and cells of a .vtu are made of them: arrays that are appended raw stay where they
/// are; if any is text, base64 or compressed, all are decoded.
///
/// Every array of numbers under `PointData` is an attribute; `TimeValue` under `FieldData` is the time.
///
/// # Errors
/// [`ReadFault::Mesh`] where there are polygons; [`ReadFault::Truncated`] and [`ReadFault::Malformed`] for damage, [`ReadFault::Compression`] for data that do
/// not unpack, or unpack beyond all reason; [`ReadFault::Unsupported`] for other compressors than zlib, several
/// pieces, and other data sets than PolyData and UnstructuredGrid; [`ReadFault::Scratch`] where they are decoded
/// into a scratch file that fails.
pub fn read_particles(bytes: Bytes, unpacking: Unpacking) -> Result<ParticleFile, ReadFault> {
    let layout = Layout::parse(&bytes)?;
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
    let vertices = vertices(&layout, decoder)?;
    Ok(ParticleFile { time, ..vertices.into_particles(bytes, format) })
}

/// Whether there are polygons, so that the file is a mesh rather than particles; a file of nothing at all is one.
///
/// # Errors
/// As [`read_particles`].
pub fn has_faces(bytes: &[u8]) -> Result<bool, ReadFault> {
    let layout = Layout::parse(&bytes)?;
    Ok(layout.points == 0 || layout.polygons > 0 || layout.strips > 0)
}

/// Reads points, their attributes, and polygons, fanned from their first corner.
///
/// Vertices, lines and the data of cells are passed over.
///
/// # Errors
/// As [`read_particles`]; besides [`ReadFault::Unsupported`] for triangle strips and an UnstructuredGrid.
pub fn read_mesh(bytes: &[u8]) -> Result<Mesh, ReadFault> {
    let layout = Layout::parse(&bytes)?;
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
        let what = format!("{} polygons are announced, {} have an offset", layout.polygons, ends.len());
        return Err(malformed(0, what));
    }
    let mut triangles = Triangles::new(layout.points)?;
    let mut start = 0;
    for (face, &end) in ends.iter().enumerate() {
        let polygon = usize::try_from(end).ok().and_then(|end| corners.get(start..end));
        let polygon = polygon
            .ok_or_else(|| malformed(0, format!("polygon {face} has no corners from {start} to {end}")))?;
        triangles.polygon(face, 0, polygon)?;
        start += polygon.len();
    }
    Ok(vertices(&layout, decoder)?.into_mesh(bytes, triangles.triangles))
}

fn time(layout: &Layout, decoder: &mut Decoder) -> Result<Option<f64>, ReadFault> {
    let found = layout.arrays.iter().find(|a| a.section == Section::FieldData && a.name == TIME);
    let Some(array) = found else { return Ok(None) };
    Ok(decoder.double(array)?.filter(|time| time.is_finite()))
}

fn vertices(layout: &Layout, mut decoder: Decoder) -> Result<Vertices, ReadFault> {
    let (count, endian) = (layout.points, layout.endian);
    if count == 0 {
        let nowhere = Column { offset: 0, stride: 0, scalar: Scalar::F32, endian };
        let attributes = Vec::new();
        return Ok(Vertices { decoded: None, count, position: [nowhere; 3], attributes, normals: None });
    }
    let is_of_points = |section| matches!(section, Section::Points | Section::PointData);
    let arrays: Vec<_> = layout.arrays.iter().filter(|array| is_of_points(array.section)).collect();
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
        attributes.push((AttributeInfo { name: array.name.clone(), components: columns.len() }, columns));
    }
    let position = position.ok_or_else(|| malformed(0, "no array of points of three components"))?;
    Ok(Vertices { decoded: decoder.finish()?, count, position, attributes, normals })
}
