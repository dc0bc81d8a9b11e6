//! The contents of a Houdini geometry: the attributes of points, and the primitives that use
//! points.
//!
//! A map may also be written as a list in which keys and values alternate. Numbers in JSON lists
//! are copied to a separate buffer. Arrays of numbers stay in the document.

mod attributes;
mod polygons;

use std::collections::BTreeMap;
use std::rc::Rc;

use crate::io::bytes::{ByteView, UnpackBuffer};
use crate::io::columns::{Endian, Scalar};
use crate::io::{ReadFault, malformed};
use crate::particles::sieve::Sieve;

use super::json::{Json, JsonEvent, JsonNumber, JsonNumbers, Storage};
use super::primitives::{is_polygon, is_smooth_curve};
pub use polygons::Polygons;
use polygons::RunFields;

/// Maximum number of components of an attribute. Attributes with more components, such as spectra,
/// are left out.
pub const MOST_COMPONENTS: u64 = 64;
/// Maximum number of texts in a text attribute. Particles cannot be selected by an attribute with
/// more texts.
pub const MOST_TEXTS: usize = 4096;
/// Maximum number of kinds of primitives that are counted separately.
const MOST_KINDS: usize = 64;
/// Number of bytes that are copied at once.
const CHUNK: usize = 1 << 13;

/// A geometry. The reader has checked that each attribute has a value for each of the announced
/// points.
#[derive(Debug)]
pub struct Geometry {
    pub points: u64,
    pub attributes: Vec<HoudiniAttribute>,
    /// Number of primitives of each kind. The kinds have the names that the file uses. Particle
    /// systems are not included.
    pub kinds: BTreeMap<Rc<str>, u64>,
    /// The index of the point of each vertex.
    pub vertex_points: NumberRun,
    /// A bit for each vertex, set if the vertex belongs to a particle system. Empty if there are no
    /// particle systems.
    pub particle_vertices: Vec<u64>,
    /// The closed polygons, if the caller requested them.
    pub polygons: Option<Polygons>,
    /// The time in seconds.
    pub time: Option<f64>,
}

/// An attribute of points.
#[derive(Debug)]
pub struct HoudiniAttribute {
    pub name: Rc<str>,
    pub values: PointValues,
    /// For a text attribute, the texts that the values refer to by index. If there are more than
    /// [`MOST_TEXTS`], only the first [`MOST_TEXTS`] + 1 are kept.
    pub texts: Option<Vec<Rc<str>>>,
}

/// The values of an attribute at all points.
#[derive(Debug)]
pub struct PointValues {
    /// Number of values per point.
    pub components: u64,
    pub data: ValueLayout,
}

/// The arrangement of the values of an attribute in the document.
#[derive(Debug)]
pub enum ValueLayout {
    /// Tuples, one per point.
    Tuples(NumberRun),
    /// Arrays, one per component.
    Arrays(Vec<NumberRun>),
    /// Pages of consecutive points.
    Pages(PointPages),
}

/// Pages of points. In a page, components are stored in groups.
#[derive(Debug)]
pub struct PointPages {
    pub run: NumberRun,
    /// Number of points per page.
    pub size: u64,
    pub groups: Vec<ComponentGroup>,
}

/// Components of an attribute that a page stores together, as one tuple per point.
#[derive(Debug)]
pub struct ComponentGroup {
    pub components: u64,
    /// A bit for each page, set if the page stores one tuple for all of its points. Empty if no
    /// page does.
    constant: Vec<u64>,
}

impl ComponentGroup {
    /// Whether a page stores one tuple for all of its points.
    pub fn is_constant(&self, page: u64) -> bool {
        let word = self.constant.get((page / 64) as usize).copied().unwrap_or_default();
        word >> (page % 64) & 1 != 0
    }

    pub fn has_constants(&self) -> bool {
        self.constant.iter().any(|&word| word != 0)
    }
}

impl PointPages {
    /// Number of values in the pages of `points` points. `None` if the number overflows.
    fn count(&self, points: u64) -> Option<u64> {
        let counted = self.groups.iter().map(|group| {
            let constant: u64 =
                group.constant.iter().map(|word| u64::from(word.count_ones())).sum();
            let pages = points.div_ceil(self.size);
            let last = pages.checked_sub(1).map_or(0, |last| points - last * self.size);
            let has_last = pages > 0 && group.is_constant(pages - 1);
            let full = constant - u64::from(has_last);
            let left_out = full * (self.size - 1) + if has_last { last - 1 } else { 0 };
            (points - left_out).checked_mul(group.components)
        });
        counted.sum()
    }
}

/// The buffer that contains numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NumberLocation {
    /// The bytes of the document.
    Document,
    /// The buffer of numbers that were copied from JSON lists.
    Gathered,
}

/// A range of consecutive numbers.
#[derive(Debug, Clone, Copy)]
pub struct NumberRun {
    pub place: NumberLocation,
    pub numbers: JsonNumbers,
}

impl NumberRun {
    /// An error about a number in this range. Numbers from JSON lists have no position.
    pub fn fault(self, what: String) -> ReadFault {
        match self.place {
            NumberLocation::Document => malformed(self.numbers.at, what),
            NumberLocation::Gathered => ReadFault::Unsupported(what),
        }
    }

    const NONE: Self = Self {
        place: NumberLocation::Document,
        numbers: JsonNumbers { at: 0, storage: Storage::Scalar(Scalar::I32), count: 0 },
    };
}

/// The parts of a geometry that a caller needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WantedParts {
    /// The points, and the number of primitives of each kind.
    Points,
    /// All of the above, and the corners of all closed polygons.
    PointsAndPolygons,
}

/// Reads the geometry of a document.
///
/// # Errors
/// [`ReadFault::Malformed`] and [`ReadFault::Truncated`] for damaged documents, with the position.
pub fn read(
    json: &mut dyn Json,
    document: (ByteView, Endian),
    gathered: &mut UnpackBuffer,
    wanted: WantedParts,
) -> Result<Geometry, ReadFault> {
    let polygons = (wanted == WantedParts::PointsAndPolygons).then(Polygons::default);
    let mut reader = SchemaReader { json, document, gathered, flag_words: 0, polygons };
    let mut head = GeometryHead::default();
    reader.entries("a geometry", |reader, key| reader.part(key, &mut head))?;
    reader.json.end()?;
    let missing = |what: &str| reader.json.fault(format!("the geometry has no {what}"));
    let points = head.points.ok_or_else(|| missing("pointcount"))?;
    Ok(Geometry {
        points,
        attributes: head.attributes.ok_or_else(|| missing("point attributes"))?,
        kinds: head.kinds,
        vertex_points: head.vertex_points.unwrap_or(NumberRun::NONE),
        particle_vertices: head.particle_vertices,
        polygons: reader.polygons,
        time: head.time,
    })
}

/// The parts of a geometry that have been read so far.
#[derive(Default)]
struct GeometryHead {
    points: Option<u64>,
    vertex_points: Option<NumberRun>,
    attributes: Option<Vec<HoudiniAttribute>>,
    has_primitives: bool,
    kinds: BTreeMap<Rc<str>, u64>,
    particle_vertices: Vec<u64>,
    time: Option<f64>,
}

struct SchemaReader<'j, 'v, 'u> {
    json: &'j mut dyn Json,
    document: (ByteView<'v>, Endian),
    gathered: &'j mut UnpackBuffer<'u>,
    /// Number of 64-bit words of page flags that were read for all attributes so far.
    flag_words: usize,
    /// The polygons that were read so far; `None` if they are not needed.
    polygons: Option<Polygons>,
}

impl SchemaReader<'_, '_, '_> {
    fn part(&mut self, key: &str, head: &mut GeometryHead) -> Result<(), ReadFault> {
        match key {
            "pointcount" => {
                self.refuse_repeated(key, head.points.is_some())?;
                head.points = Some(self.count(key)?);
            }
            "info" => {
                // Read only the time, and skip all other values.
                let first = self.json.next()?;
                if matches!(first, JsonEvent::List | JsonEvent::Map) {
                    self.entries_within(|reader, key| match (key, reader.json.next()?) {
                        ("time", JsonEvent::Real(time)) => {
                            head.time = Some(time).filter(|time| time.is_finite());
                            Ok(())
                        }
                        ("time", JsonEvent::Integer(time)) => {
                            head.time = Some(time as f64);
                            Ok(())
                        }
                        (_, other) => reader.skip(other),
                    })?;
                }
            }
            "topology" => self.entries("the topology", |reader, key| match key {
                "pointref" => reader.entries("pointref", |reader, key| match key {
                    "indices" => {
                        reader.refuse_repeated(key, head.vertex_points.is_some())?;
                        let run = reader.numbers("indices", Storage::Scalar(Scalar::I64))?;
                        head.vertex_points = Some(run);
                        Ok(())
                    }
                    _ => reader.skip_value(),
                }),
                _ => reader.skip_value(),
            })?,
            "attributes" => {
                let points = head.points;
                let points = points.ok_or_else(|| {
                    self.json.fault("attributes come before pointcount".to_owned())
                })?;
                self.entries("the attributes", |reader, key| match key {
                    "pointattributes" => {
                        reader.refuse_repeated(key, head.attributes.is_some())?;
                        head.attributes = Some(reader.attributes(points)?);
                        Ok(())
                    }
                    _ => reader.skip_value(),
                })?;
            }
            "primitives" => {
                self.refuse_repeated(key, head.has_primitives)?;
                head.has_primitives = true;
                self.primitives(head)?;
            }
            _ => self.skip_value()?,
        }
        Ok(())
    }

    /// Returns an error if the part `key` was read before. Later parts were checked against the
    /// earlier one.
    fn refuse_repeated(&self, key: &str, is_repeated: bool) -> Result<(), ReadFault> {
        match is_repeated {
            true => Err(self.json.fault(format!("the geometry contains {key} twice"))),
            false => Ok(()),
        }
    }

    /// Reads a list or map of entries. Calls `take` with each key. `take` must read the value.
    fn entries(
        &mut self,
        what: &str,
        take: impl FnMut(&mut Self, &str) -> Result<(), ReadFault>,
    ) -> Result<(), ReadFault> {
        match self.json.next()? {
            JsonEvent::List | JsonEvent::Map => self.entries_within(take),
            // Some writers write an empty list as an empty array of numbers.
            JsonEvent::Numbers(JsonNumbers { count: 0, .. }) => Ok(()),
            _ => Err(self.json.fault(format!("{what} must be a list of keys and values"))),
        }
    }

    /// Reads the entries of a list or map after its start.
    fn entries_within(
        &mut self,
        mut take: impl FnMut(&mut Self, &str) -> Result<(), ReadFault>,
    ) -> Result<(), ReadFault> {
        loop {
            match self.json.next()? {
                JsonEvent::End => return Ok(()),
                JsonEvent::Text(key) => take(self, &key)?,
                _ => return Err(self.json.fault("expected a key".to_owned())),
            }
        }
    }

    fn skip_value(&mut self) -> Result<(), ReadFault> {
        let first = self.json.next()?;
        self.skip(first)
    }

    /// Skips the rest of a value whose first event was `first`.
    fn skip(&mut self, first: JsonEvent) -> Result<(), ReadFault> {
        let mut event = first;
        let mut depth = 0_usize;
        loop {
            match event {
                JsonEvent::List | JsonEvent::Map => depth += 1,
                JsonEvent::End if depth == 0 => {
                    return Err(self.json.fault("a list ends where a value should be".to_owned()));
                }
                JsonEvent::End => depth -= 1,
                _ => {}
            }
            if depth == 0 {
                return Ok(());
            }
            event = self.json.next()?;
        }
    }

    fn count(&mut self, what: &str) -> Result<u64, ReadFault> {
        match self.json.next()? {
            JsonEvent::Integer(count @ 0..) => Ok(count as u64),
            other => Err(self.json.fault(format!("{what} cannot be {}", shown(&other)))),
        }
    }

    fn text(&mut self, what: &str) -> Result<Rc<str>, ReadFault> {
        match self.json.next()? {
            JsonEvent::Text(text) => Ok(text),
            other => Err(self.json.fault(format!("{what} cannot be {}", shown(&other)))),
        }
    }

    /// Reads a list of numbers. A JSON list is copied, and its numbers are converted to `storage`.
    fn numbers(&mut self, what: &str, storage: Storage) -> Result<NumberRun, ReadFault> {
        let first = self.json.next()?;
        self.numbers_from(first, what, storage)
    }

    fn numbers_from(
        &mut self,
        first: JsonEvent,
        what: &str,
        storage: Storage,
    ) -> Result<NumberRun, ReadFault> {
        match first {
            JsonEvent::Numbers(JsonNumbers { storage: Storage::Bits, .. }) => {
                return Err(self.json.fault(format!("{what} cannot be an array of booleans")));
            }
            JsonEvent::Numbers(numbers) => {
                return Ok(NumberRun { place: NumberLocation::Document, numbers });
            }
            JsonEvent::List => {}
            other => {
                return Err(self
                    .json
                    .fault(format!("expected numbers for {what}, found {}", shown(&other))));
            }
        }
        let scalar = storage.scalar();
        let (at, mut count) = (self.gathered.len() as usize, 0);
        let mut chunk = Vec::new();
        loop {
            let number = match self.json.next()? {
                JsonEvent::End => break,
                JsonEvent::Integer(whole) => JsonNumber::Integer(whole),
                JsonEvent::Real(real) => JsonNumber::Real(real),
                JsonEvent::Bool(truth) => JsonNumber::Integer(truth.into()),
                other => {
                    return Err(self
                        .json
                        .fault(format!("expected numbers for {what}, found {}", shown(&other))));
                }
            };
            number.put(scalar, &mut chunk).ok_or_else(|| {
                self.json.fault(format!("a number of {what} is out of the range of its type"))
            })?;
            count += 1;
            if chunk.len() >= CHUNK {
                self.gathered.push(&chunk)?;
                chunk.clear();
            }
        }
        self.gathered.push(&chunk)?;
        let numbers = JsonNumbers { at, storage: Storage::Scalar(scalar), count };
        Ok(NumberRun { place: NumberLocation::Gathered, numbers })
    }

    /// Copies numbers of the document to `gathered`, in which the numbers of consecutive lists are
    /// adjacent.
    fn gather(&mut self, numbers: JsonNumbers) -> Result<NumberRun, ReadFault> {
        let (bytes, endian) = self.document;
        let scalar = numbers.storage.scalar();
        let at = self.gathered.len() as usize;
        let mut chunk = Vec::new();
        numbers.each(bytes, endian, |number| {
            number.put(scalar, &mut chunk).expect("a number fits its own type");
            if chunk.len() >= CHUNK {
                self.gathered.push(&chunk)?;
                chunk.clear();
            }
            Ok(())
        })?;
        self.gathered.push(&chunk)?;
        let numbers = JsonNumbers { at, storage: Storage::Scalar(scalar), ..numbers };
        Ok(NumberRun { place: NumberLocation::Gathered, numbers })
    }

    /// Calls `take` with each number of a list, or with a single number.
    fn each(&mut self, mut take: impl FnMut(JsonNumber)) -> Result<(), ReadFault> {
        let (bytes, endian) = self.document;
        match self.json.next()? {
            JsonEvent::Numbers(numbers) => {
                return numbers.each(bytes, endian, |number| {
                    take(number);
                    Ok(())
                });
            }
            JsonEvent::Integer(whole) => {
                take(JsonNumber::Integer(whole));
                return Ok(());
            }
            JsonEvent::List => {}
            other => {
                return Err(self.json.fault(format!("expected numbers, found {}", shown(&other))));
            }
        }
        loop {
            match self.json.next()? {
                JsonEvent::End => return Ok(()),
                JsonEvent::Integer(whole) => take(JsonNumber::Integer(whole)),
                JsonEvent::Real(real) => take(JsonNumber::Real(real)),
                JsonEvent::Bool(truth) => take(JsonNumber::Integer(truth.into())),
                other => self.skip(other)?,
            }
        }
    }

    /// Reads a list of pairs. `take` must read both values of a pair.
    fn pairs(
        &mut self,
        what: &str,
        mut take: impl FnMut(&mut Self) -> Result<(), ReadFault>,
    ) -> Result<(), ReadFault> {
        match self.json.next()? {
            JsonEvent::List => {}
            JsonEvent::Numbers(JsonNumbers { count: 0, .. }) => return Ok(()),
            other => {
                return Err(self.json.fault(format!("expected {what}, found {}", shown(&other))));
            }
        }
        loop {
            match self.json.next()? {
                JsonEvent::End => return Ok(()),
                JsonEvent::List => take(self)?,
                other => return Err(self.json.fault(format!("{what} contain {}", shown(&other)))),
            }
            match self.json.next()? {
                JsonEvent::End => {}
                other => {
                    let what = format!("a pair of {what} contains {}", shown(&other));
                    return Err(self.json.fault(what));
                }
            }
        }
    }

    /// Counts the primitives of each kind, and marks the vertices of particle systems.
    fn primitives(&mut self, head: &mut GeometryHead) -> Result<(), ReadFault> {
        let vertices = head.vertex_points.map_or(0, |run| run.numbers.count);
        if self.polygons.is_some() && vertices > u32::MAX.into() {
            let what =
                format!("the polygons have {vertices} corners, but at most 2^32 - 1 can be read");
            return Err(ReadFault::Unsupported(what));
        }
        self.pairs("the primitives", |reader| {
            let (mut kind, mut run_kind) = (None, None);
            let mut fields = RunFields::default();
            reader.entries("a primitive's kind", |reader, key| {
                match key {
                    "type" => kind = Some(reader.text("a primitive's type")?),
                    "runtype" => run_kind = Some(reader.text("a primitive's type")?),
                    _ => reader.field_of_run(key, &mut fields)?,
                }
                Ok(())
            })?;
            let kind =
                kind.ok_or_else(|| reader.json.fault("a primitive has no type".to_owned()))?;
            let mut count = 1;
            let (kind, is_run) = match run_kind {
                Some(run_kind) if &*kind == "run" => (run_kind, true),
                _ => (kind, false),
            };
            let is_particles = &*kind == "Part";
            if reader.polygons.is_some() && is_polygon(&kind) {
                let count = match is_run {
                    true => reader.run_of_polygons(&fields, vertices)?,
                    false => reader.polygons(&kind, vertices)?,
                };
                add_kind(&mut head.kinds, kind, count);
                return Ok(());
            }
            if reader.polygons.is_some() && is_smooth_curve(&kind) {
                let mut closed = fields.closed;
                if is_run {
                    count = reader.items()?;
                } else {
                    reader.entries("a curve", |reader, key| {
                        reader.truth_of_closed(key, &mut closed)
                    })?;
                }
                // A closed curve is a filled face.
                let is_face = closed != Some(false);
                let kind = if is_face { format!("closed {kind}").into() } else { kind };
                add_kind(&mut head.kinds, kind, count);
                return Ok(());
            }
            let mut mark = |number: JsonNumber| {
                if let JsonNumber::Integer(vertex) = number
                    && let Ok(vertex) = u64::try_from(vertex)
                    && vertex < vertices
                {
                    if head.particle_vertices.is_empty() {
                        head.particle_vertices = Sieve::none(vertices as usize);
                    }
                    Sieve::set(&mut head.particle_vertices, vertex as usize);
                }
            };
            if is_run {
                count = reader.items()?;
            } else {
                reader.entries("a primitive", |reader, key| match key {
                    "n_p" | "nprimitives" => {
                        count = reader.count(key)?;
                        Ok(())
                    }
                    "vertex" if is_particles => reader.each(&mut mark),
                    _ => reader.skip_value(),
                })?;
            }
            if !is_particles {
                add_kind(&mut head.kinds, kind, count);
            }
            Ok(())
        })
    }

    /// Skips a list of values. Returns their number.
    fn items(&mut self) -> Result<u64, ReadFault> {
        match self.json.next()? {
            JsonEvent::Numbers(numbers) => return Ok(numbers.count),
            JsonEvent::List => {}
            other => {
                return Err(self.json.fault(format!("expected a list, found {}", shown(&other))));
            }
        }
        let mut count = 0;
        loop {
            match self.json.next()? {
                JsonEvent::End => return Ok(count),
                other => self.skip(other)?,
            }
            count += 1;
        }
    }
}

/// Adds `count` primitives of a kind.
fn add_kind(kinds: &mut BTreeMap<Rc<str>, u64>, kind: Rc<str>, count: u64) {
    if count == 0 {
        return;
    }
    let is_known = kinds.len() < MOST_KINDS || kinds.contains_key(&kind);
    let kind = if is_known { kind } else { "other".into() };
    let all = kinds.entry(kind).or_default();
    *all = all.saturating_add(count);
}

/// Describes an event for a message.
fn shown(event: &JsonEvent) -> String {
    match event {
        JsonEvent::List => "a list".to_owned(),
        JsonEvent::Map => "a map".to_owned(),
        JsonEvent::End => "the end of a list".to_owned(),
        JsonEvent::Null => "null".to_owned(),
        JsonEvent::Bool(truth) => truth.to_string(),
        JsonEvent::Integer(whole) => whole.to_string(),
        JsonEvent::Real(real) => real.to_string(),
        JsonEvent::Text(text) => format!("{:?}", text.chars().take(40).collect::<String>()),
        JsonEvent::Numbers(numbers) => format!("an array of {} numbers", numbers.count),
    }
}
