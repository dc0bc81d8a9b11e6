//! Reads and writes geometry of Houdini 12 and later: `.geo` is text, `.bgeo` is binary, and
//! `.bgeo.sc` is compressed by Blosc.
//!
//! The content of a file, not its extension, determines its form. A `.bgeo` file may also be in the
//! classic format. A point is a particle if it belongs to no primitive, or only to particle
//! systems.

mod binary;
mod blosc;
mod container;
mod json;
mod points;
mod primitives;
mod schema;
mod text;
mod write;

use std::path::Path;

use crate::particles::AttributeInfo;
use crate::particles::sieve::Sieve;
use crate::surface::mesh::Mesh;

use super::bytes::{ByteView, Bytes, PrivateBytes, UnpackBuffer, Unpacking, unpacked_limit};
use super::columns::{Column, ColumnStore, Endian, ParticleRows};
use super::vertices::{Triangles, mesh_of};
use super::wanted::{WantedAttributes, WantedParticles};
use super::windows::InputBytes;
use super::{ParticleFile, ReadError, ReadFault, UnreadPart, bgeo, malformed};
use binary::Binary;
use json::JsonNumber;
use points::{NumberBytes, UnpackedColumns};
pub use primitives::Primitives;
use primitives::is_polygon_or_curve;
pub(super) use schema::MOST_TEXTS;
use schema::{Geometry, HoudiniAttribute, NumberLocation, WantedParts};
use text::Text;
pub use write::{attribute_names, write_mesh};

/// Number of bytes at the start of a file from which its form is detected.
const HEAD: usize = 64;
/// Size, in bytes, of a position of three f32 numbers.
const POSITION: u64 = 12;

/// The first bytes of a geometry file, unpacked if they are in a container. Empty for a damaged
/// container.
pub(super) fn first_bytes(view: ByteView, count: usize) -> Vec<u8> {
    let mut first = match view.read(0..view.len().min(count)) {
        Ok(head) if head.starts_with(container::MAGIC) => {
            container::first_chunk(view).unwrap_or_default()
        }
        Ok(head) => head.into_owned(),
        Err(_) => Vec::new(),
    };
    first.truncate(count);
    first
}

/// The form of a geometry file.
enum GeometryForm {
    Classic,
    Binary(Endian),
    Text,
    Container,
}

impl GeometryForm {
    fn of(view: ByteView) -> Result<Self, ReadFault> {
        let head = view.read(0..view.len().min(HEAD))?;
        if head.starts_with(b"BgeoV") {
            return Ok(Self::Classic);
        }
        if head.starts_with(container::MAGIC) {
            return Ok(Self::Container);
        }
        if let Some(endian) = binary::byte_order(&head) {
            return Ok(Self::Binary(endian));
        }
        let text = head.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&head).trim_ascii_start();
        if text.starts_with(b"[") || text.starts_with(b"{") {
            return Ok(Self::Text);
        }
        if text.starts_with(b"PGEOMETRY") {
            let what = "the classic .geo text format is not supported; save it as .bgeo.sc";
            return Err(ReadFault::Unsupported(what.to_owned()));
        }
        Err(malformed(
            0,
            "not a Houdini geometry: the file starts neither with \"BgeoV\" nor with JSON",
        ))
    }
}

/// Opens a geometry of any version of Houdini.
///
/// # Errors
/// The errors of [`read_particles`].
pub(super) fn open_particles(
    path: &Path,
    bytes: Bytes,
    wanted: WantedParticles,
    unpacking: Unpacking,
) -> Result<ParticleFile, ReadError> {
    read_particles(bytes, wanted.attributes, unpacking).map_err(|fault| ReadError::new(path, fault))
}

/// Reads the particles of a geometry of any version of Houdini.
///
/// # Errors
/// [`ReadFault::Malformed`] and [`ReadFault::Truncated`] for damaged files,
/// [`ReadFault::OnlyPrimitives`] if all points belong to polygons, packed geometry or other
/// primitives, and [`ReadFault::Scratch`] if the scratch file cannot be written.
pub fn read_particles(
    bytes: Bytes,
    wanted: WantedAttributes,
    unpacking: Unpacking,
) -> Result<ParticleFile, ReadFault> {
    match GeometryForm::of(bytes.view())? {
        GeometryForm::Classic => bgeo::read_particles(bytes),
        form => {
            let opened = OpenedGeometry::of(bytes, form, unpacking, WantedParts::Points)?;
            let selected = opened.select_particles()?;
            opened.arrange(selected, wanted, unpacking)
        }
    }
}

/// Reads all points of a geometry of Houdini 12 or later. Points of polygons and other primitives
/// are included.
///
/// # Errors
/// The errors of [`read_particles`] for damaged files and scratch files.
pub fn read_points(
    bytes: Bytes,
    wanted: WantedAttributes,
    unpacking: Unpacking,
) -> Result<ParticleFile, ReadFault> {
    let form = GeometryForm::of(bytes.view())?;
    let opened = OpenedGeometry::of(bytes, form, unpacking, WantedParts::Points)?;
    opened.arrange(None, wanted, unpacking)
}

/// Reads the polygons of a geometry of Houdini 12 or later, with all attributes of the points.
/// Curves, and points without polygons, have no surface.
///
/// # Errors
/// The errors of [`read_particles`] for damaged files, and [`ReadFault::Unsupported`] for classic
/// files and for primitives with a surface that are not polygons.
pub fn read_mesh(bytes: Bytes) -> Result<Mesh, ReadFault> {
    let unpacking = Unpacking::in_memory();
    let form = GeometryForm::of(bytes.view())?;
    if let GeometryForm::Classic = form {
        let what =
            "meshes in the classic .bgeo format are not supported; save the mesh as .bgeo.sc";
        return Err(ReadFault::Unsupported(what.to_owned()));
    }
    // The polygons are read several times, so other programs must not change them meanwhile.
    let bytes = Bytes::Kept(bytes.read_whole(unpacking)?);
    let mut opened = OpenedGeometry::of(bytes, form, unpacking, WantedParts::PointsAndPolygons)?;
    let triangles = opened.triangles()?;
    // A mesh has no text attributes.
    opened.geometry.attributes.retain(|attribute| attribute.texts.is_none());
    let points = opened.arrange(None, WantedAttributes::All, unpacking)?.particles;
    Ok(mesh_of(&points, "N", triangles))
}

/// A geometry, and the bytes that contain its numbers.
struct OpenedGeometry {
    geometry: Geometry,
    bytes: Bytes,
    endian: Endian,
    gathered: PrivateBytes,
    /// The name of the format.
    format: &'static str,
}

impl OpenedGeometry {
    fn of(
        bytes: Bytes,
        form: GeometryForm,
        unpacking: Unpacking,
        wanted: WantedParts,
    ) -> Result<Self, ReadFault> {
        let (bytes, form, format) = match form {
            GeometryForm::Container => {
                let unpacked = Bytes::Kept(container::unpack(bytes, unpacking)?);
                let form = GeometryForm::of(unpacked.view())?;
                (unpacked, form, "Houdini .bgeo.sc")
            }
            // Text is read as a whole, so that other programs cannot change it while it is decoded.
            GeometryForm::Text => (Bytes::Kept(bytes.read_whole(unpacking)?), form, "Houdini .geo"),
            form => (bytes, form, "Houdini .bgeo"),
        };
        let mut gathered = UnpackBuffer::new(unpacking);
        let view = bytes.view();
        let (geometry, endian) = match form {
            GeometryForm::Text => {
                let document = (view, Endian::Little);
                let mut json = Text::new(view.kept()?);
                (schema::read(&mut json, document, &mut gathered, wanted)?, document.1)
            }
            GeometryForm::Binary(endian) => {
                let document = (view, endian);
                let mut json = Binary::new(view, endian);
                (schema::read(&mut json, document, &mut gathered, wanted)?, endian)
            }
            GeometryForm::Classic | GeometryForm::Container => {
                return Err(malformed(0, "the file contains no geometry of Houdini 12 or later"));
            }
        };
        view.check()?;
        // A constant page stores one tuple for all of its points, so a small file can announce any
        // number of points. This check limits the number.
        if geometry.points > unpacked_limit(view.len() as u64) / POSITION {
            let what = format!(
                "{} points are too many for a file of {} bytes",
                geometry.points,
                view.len()
            );
            return Err(ReadFault::Compression(what));
        }
        let gathered = gathered.finish()?;
        Ok(Self { geometry, bytes, endian, gathered, format })
    }

    fn number_bytes(&self) -> NumberBytes<'_> {
        NumberBytes { document: self.bytes.view(), endian: self.endian, gathered: &self.gathered }
    }

    /// Calls `take` with each vertex and its point.
    fn each_vertex(&self, mut take: impl FnMut(usize, u64)) -> Result<(), ReadFault> {
        let Geometry { points, vertex_points: run, .. } = self.geometry;
        let mut vertex = 0;
        let (bytes, endian) = self.number_bytes().of(run.place);
        run.numbers.each(bytes, endian, |number| {
            let point = match number {
                JsonNumber::Integer(point) => {
                    u64::try_from(point).ok().filter(|point| *point < points)
                }
                JsonNumber::Real(_) => None,
            };
            let point = point.ok_or_else(|| {
                run.fault(format!(
                    "vertex {vertex} refers to point {number}, but there are {points} points, \
                     numbered from 0"
                ))
            })?;
            take(vertex, point);
            vertex += 1;
            Ok(())
        })
    }

    /// Divides the polygons into triangles.
    ///
    /// # Errors
    /// [`ReadFault::Unsupported`] for primitives with a surface that are not polygons, and for too
    /// many points.
    fn triangles(&self) -> Result<Vec<[u32; 3]>, ReadFault> {
        let geometry = &self.geometry;
        let others = geometry.kinds.iter().filter(|(kind, _)| !is_polygon_or_curve(kind));
        let others = Primitives::new(others.map(|(kind, count)| (&**kind, *count)), 0);
        if !others.kinds.is_empty() {
            let what = format!(
                "only polygons can be read as a mesh, and the file contains {}; {}",
                others.counted(),
                others.mesh_remedy()
            );
            return Err(ReadFault::Unsupported(what));
        }
        let mut polygons = geometry.polygons.iter().flat_map(|polygons| polygons.iter());
        if geometry.points > 0 && polygons.next().is_none() {
            let what = format!("the file contains no polygons, only {} points", geometry.points);
            return Err(ReadFault::Unsupported(what));
        }
        let mut triangles = Triangles::new(geometry.points as usize)?;
        let mut points = Vec::new();
        self.each_vertex(|_, point| points.push(point as i64))?;
        let mut corners = Vec::new();
        let polygons = geometry.polygons.iter().flat_map(|polygons| polygons.iter());
        for (number, vertices) in polygons.enumerate() {
            // In Houdini, polygons are clockwise as seen from outside.
            let Some((first, others)) = vertices.split_first() else { continue };
            let reversed = [first].into_iter().chain(others.iter().rev());
            corners.clear();
            corners.extend(reversed.map(|&vertex| points[vertex as usize]));
            triangles.polygon(number, 0, &corners)?;
        }
        Ok(triangles.triangles)
    }

    /// Selects the particles: the points that belong to no primitive, or only to particle systems.
    /// Returns `None` if all points are particles.
    ///
    /// # Errors
    /// [`ReadFault::OnlyPrimitives`] if there are points, but no particles.
    fn select_particles(&self) -> Result<Option<Sieve>, ReadFault> {
        let geometry = &self.geometry;
        if geometry.kinds.is_empty() {
            return Ok(None);
        }
        let points = geometry.points;
        // This allocates one bit per point. `OpenedGeometry::of` has checked that the number of
        // points is not too large for the file.
        let mut used_by_primitives = Sieve::none(points as usize);
        self.each_vertex(|vertex, point| {
            let word = geometry.particle_vertices.get(vertex / 64).copied().unwrap_or_default();
            if word >> (vertex % 64) & 1 == 0 {
                Sieve::set(&mut used_by_primitives, point as usize);
            }
        })?;
        let mut unused = used_by_primitives;
        unused.iter_mut().for_each(|word| *word = !*word);
        if let Some(last) = unused.last_mut()
            && !points.is_multiple_of(64)
        {
            *last &= (1 << (points % 64)) - 1;
        }
        let sieve = Sieve::new(unused);
        if sieve.count() == 0 && points > 0 {
            return Err(ReadFault::OnlyPrimitives(primitives(geometry, points)));
        }
        Ok(Some(sieve).filter(|sieve| (sieve.count() as u64) < points))
    }

    /// Makes a particle file of the selected points, or of all points, with the wanted attributes.
    fn arrange(
        self,
        selected: Option<Sieve>,
        wanted: WantedAttributes,
        unpacking: Unpacking,
    ) -> Result<ParticleFile, ReadFault> {
        let stored_numbers = self.number_bytes();
        let Geometry { points, attributes, time, .. } = &self.geometry;
        let is_position = |a: &&HoudiniAttribute| &*a.name == "P" && a.texts.is_none();
        let position = attributes.iter().find(is_position).ok_or_else(|| {
            ReadFault::Unsupported("the point attribute P (the position) is missing".to_owned())
        })?;
        if !matches!(position.values.components, 3 | 4) {
            let what = format!("P has {} components, not 3 or 4", position.values.components);
            return Err(ReadFault::Unsupported(what));
        }
        let others = || attributes.iter().filter(|a| &*a.name != "P");
        let numeric: Vec<&HoudiniAttribute> = others().filter(|a| a.texts.is_none()).collect();
        let info =
            |a: &&HoudiniAttribute| AttributeInfo::new(&*a.name, a.values.components as usize);
        let infos: Vec<_> = numeric.iter().map(info).collect();
        let is_read = wanted.among(&infos);
        let read: Vec<&HoudiniAttribute> =
            numeric.iter().zip(&is_read).filter_map(|(a, read)| read.then_some(*a)).collect();
        let labels = others().filter(|a| a.texts.is_some() && wanted.includes_label(&a.name));
        let labels: Vec<&HoudiniAttribute> = labels.collect();

        let found = |attribute: &&HoudiniAttribute| stored_numbers.columns(&attribute.values);
        let in_place: Option<Vec<_>> = [position].iter().chain(&read).map(found).collect();
        let in_place = in_place.filter(|found| {
            labels.is_empty() && found.iter().all(|(place, _)| *place == found[0].0)
        });
        let (columns, unpacked, label_columns) = match in_place {
            Some(found) => {
                let place = found[0].0;
                (found.into_iter().map(|(_, columns)| columns).collect(), Err(place), Vec::new())
            }
            None => {
                let mut columns = UnpackedColumns::new(stored_numbers, *points, unpacking);
                let all = [position].into_iter().chain(read.iter().copied());
                let numbers: Vec<Vec<Column>> =
                    all.map(|attribute| columns.push(attribute)).collect::<Result<_, _>>()?;
                let mut found = Vec::new();
                for label in labels {
                    found.extend(columns.push_texts(label)?);
                }
                stored_numbers.document.check()?;
                (numbers, Ok(columns.finish()?), found)
            }
        };
        let source: InputBytes = match unpacked {
            Ok(unpacked) => unpacked.into(),
            Err(NumberLocation::Gathered) => self.gathered.into(),
            Err(NumberLocation::Document) => self.bytes.into(),
        };
        let mut columns = columns.into_iter();
        let position = columns.next().expect("the position is the first");
        let position = [position[0], position[1], position[2]];
        let infos_read = read.iter().map(info);
        let attributes = infos_read.zip(columns).collect();
        let (rows, left_out) = match selected {
            None => (ParticleRows::All(*points as usize), None),
            Some(sieve) => {
                let count = *points - sieve.count() as u64;
                let primitives = primitives(&self.geometry, count);
                (ParticleRows::Selected(sieve), Some(UnreadPart::Primitives(primitives)))
            }
        };
        let store: ColumnStore = ColumnStore::new(source, rows, position, attributes);
        let store = store.with_labels(label_columns);
        let unread = infos.into_iter().zip(is_read).filter(|(_, read)| !read);
        let unread = unread.map(|(info, _)| info).collect();
        let left_out = left_out.into_iter().collect();
        Ok(ParticleFile { time: *time, unread, left_out, ..ParticleFile::new(store, self.format) })
    }
}

/// The primitives of a geometry. `points` is the number of points that they use.
fn primitives(geometry: &Geometry, points: u64) -> Primitives {
    Primitives::new(geometry.kinds.iter().map(|(kind, count)| (&**kind, *count)), points)
}
