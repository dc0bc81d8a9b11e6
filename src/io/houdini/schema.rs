//! The contents of a Houdini geometry: the points' attributes, and the primitives that use points.
//!
//! Lists alternate keys and values like maps. Numbers in short lists are copied to a separate
//! buffer; arrays of numbers stay in the document.

use std::collections::BTreeMap;
use std::rc::Rc;

use crate::io::bytes::{ByteView, UnpackBuffer};
use crate::io::columns::{Endian, Scalar};
use crate::io::{ReadFault, malformed};
use crate::particles::sieve::Sieve;

use super::json::{Json, JsonEvent, JsonNumber, JsonNumbers, Storage};

/// Maximum number of attributes; production files have a few hundred.
const MOST_ATTRIBUTES: usize = 1 << 16;
/// Maximum length of an attribute's name in bytes.
const LONGEST_NAME: usize = 1 << 10;
/// Maximum number of components of an attribute: more are a spectrum.
pub const MOST_COMPONENTS: u64 = 64;
/// Maximum number of texts of an attribute that can be used for selection.
pub const MOST_TEXTS: usize = 4096;
/// Maximum number of different kinds of primitives.
const MOST_KINDS: usize = 64;
/// Maximum number of words for flags of constant pages, of all attributes: enough for 10^11 points.
const MOST_FLAGS: usize = 1 << 20;
/// Numbers per copy.
const CHUNK: usize = 1 << 13;

/// A geometry, whose attributes have the announced length.
#[derive(Debug)]
pub struct Geometry {
    pub points: u64,
    pub attributes: Vec<HoudiniAttribute>,
    /// Number of primitives of each kind, with the file's names, without particle systems.
    pub kinds: BTreeMap<Rc<str>, u64>,
    /// The point of each vertex.
    pub vertex_points: NumberRun,
    /// A bit for each vertex, set in particle systems; empty without particle systems.
    pub particle_vertices: Vec<u64>,
    /// The time in seconds.
    pub time: Option<f64>,
}

/// A value of every point.
#[derive(Debug)]
pub struct HoudiniAttribute {
    pub name: Rc<str>,
    pub values: PointValues,
    /// The strings, if the values are indices of strings; empty if there are too many.
    pub texts: Option<Vec<Rc<str>>>,
}

/// The numbers of all points.
#[derive(Debug)]
pub struct PointValues {
    /// Numbers per point.
    pub components: u64,
    pub data: ValueLayout,
}

/// The arrangement of numbers.
#[derive(Debug)]
pub enum ValueLayout {
    /// Point by point.
    Tuples(NumberRun),
    /// Component by component.
    Arrays(Vec<NumberRun>),
    /// Page by page.
    Pages(PointPages),
}

/// Pages of points, divided into groups of components.
#[derive(Debug)]
pub struct PointPages {
    pub run: NumberRun,
    /// Points per page.
    pub size: u64,
    pub groups: Vec<ComponentGroup>,
}

/// Components that are stored together.
#[derive(Debug)]
pub struct ComponentGroup {
    pub components: u64,
    /// A bit for each page that stores one tuple for all of its points; empty if no page does.
    constant: Vec<u64>,
}

impl ComponentGroup {
    /// Whether a page stores one tuple for all points.
    pub fn is_constant(&self, page: u64) -> bool {
        let word = self.constant.get((page / 64) as usize).copied().unwrap_or_default();
        word >> (page % 64) & 1 != 0
    }

    pub fn has_constants(&self) -> bool {
        self.constant.iter().any(|&word| word != 0)
    }
}

impl PointPages {
    /// Count of numbers in the pages of `points`; `None` if it overflows.
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

/// The location of numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NumberLocation {
    /// In the document.
    Document,
    /// In the buffer of numbers from lists.
    Gathered,
}

/// Consecutive numbers.
#[derive(Debug, Clone, Copy)]
pub struct NumberRun {
    pub place: NumberLocation,
    pub numbers: JsonNumbers,
}

impl NumberRun {
    /// A fault of a number in it. Numbers from lists have no position.
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

/// Reads the geometry of a document.
///
/// # Errors
/// Damage, with its position.
pub fn read(
    json: &mut dyn Json,
    document: (ByteView, Endian),
    gathered: &mut UnpackBuffer,
) -> Result<Geometry, ReadFault> {
    let mut reader = SchemaReader { json, document, gathered, flag_words: 0 };
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
        time: head.time,
    })
}

/// The parts of a geometry that were read so far.
#[derive(Default)]
struct GeometryHead {
    points: Option<u64>,
    vertex_points: Option<NumberRun>,
    attributes: Option<Vec<HoudiniAttribute>>,
    kinds: BTreeMap<Rc<str>, u64>,
    particle_vertices: Vec<u64>,
    time: Option<f64>,
}

struct SchemaReader<'j, 'v, 'u> {
    json: &'j mut dyn Json,
    document: (ByteView<'v>, Endian),
    gathered: &'j mut UnpackBuffer<'u>,
    flag_words: usize,
}

impl SchemaReader<'_, '_, '_> {
    fn part(&mut self, key: &str, head: &mut GeometryHead) -> Result<(), ReadFault> {
        match key {
            "pointcount" => head.points = Some(self.count("pointcount")?),
            "info" => {
                // Only the time matters.
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
                        head.attributes = Some(reader.attributes(points)?);
                        Ok(())
                    }
                    _ => reader.skip_value(),
                })?;
            }
            "primitives" => self.primitives(head)?,
            _ => self.skip_value()?,
        }
        Ok(())
    }

    /// Passes the key of each entry to `take`, which reads the value.
    fn entries(
        &mut self,
        what: &str,
        take: impl FnMut(&mut Self, &str) -> Result<(), ReadFault>,
    ) -> Result<(), ReadFault> {
        match self.json.next()? {
            JsonEvent::List | JsonEvent::Map => self.entries_within(take),
            // Some writers write an empty list like this.
            JsonEvent::Numbers(JsonNumbers { count: 0, .. }) => Ok(()),
            _ => Err(self.json.fault(format!("expected {what} as a list of keys and values"))),
        }
    }

    /// Processes the rest of a list after its start.
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

    /// Skips the rest of a value that starts with this event.
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
            other => Err(self.json.fault(format!("{what} is {}", shown(&other)))),
        }
    }

    fn text(&mut self, what: &str) -> Result<Rc<str>, ReadFault> {
        match self.json.next()? {
            JsonEvent::Text(text) => Ok(text),
            other => Err(self.json.fault(format!("{what} is {}", shown(&other)))),
        }
    }

    /// A list of numbers; those of a JSON list are copied as `storage`.
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
                return Err(self.json.fault(format!("{what} is an array of booleans")));
            }
            JsonEvent::Numbers(numbers) => {
                return Ok(NumberRun { place: NumberLocation::Document, numbers });
            }
            JsonEvent::List => {}
            other => {
                return Err(self
                    .json
                    .fault(format!("expected {what} as numbers, found {}", shown(&other))));
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
                        .fault(format!("{} among the numbers of {what}", shown(&other))));
                }
            };
            number.put(scalar, &mut chunk).ok_or_else(|| {
                self.json.fault(format!("a number of {what} does not fit its type"))
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

    /// Copies numbers of the document, as one of several lists.
    fn gather(&mut self, numbers: JsonNumbers) -> Result<NumberRun, ReadFault> {
        let (bytes, endian) = self.document;
        let scalar = numbers.storage.scalar();
        let at = self.gathered.len() as usize;
        let mut chunk = Vec::new();
        numbers.each(bytes, endian, |number| {
            number.put(scalar, &mut chunk).expect("it was of this type");
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

    /// Passes each number of a list, or a single number, to `take`.
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

    /// Reads definitions of attributes with their data.
    fn attributes(&mut self, points: u64) -> Result<Vec<HoudiniAttribute>, ReadFault> {
        let mut attributes = Vec::new();
        self.pairs("the point attributes", |reader| {
            let (mut kind, mut name) = (None, None);
            reader.entries("an attribute's definition", |reader, key| {
                match key {
                    "type" => kind = Some(reader.text("an attribute's type")?),
                    "name" => name = Some(reader.text("an attribute's name")?),
                    _ => reader.skip_value()?,
                }
                Ok(())
            })?;
            let missing = || reader.json.fault("an attribute without a name or type".to_owned());
            let (kind, name) = kind.zip(name).ok_or_else(missing)?;
            if name.len() > LONGEST_NAME {
                let what = format!("the name of an attribute is {} bytes long", name.len());
                return Err(reader.json.fault(what));
            }
            let attribute = match &*kind {
                "numeric" => reader.numeric(name, points)?,
                "string" => reader.strings(name, points)?,
                // Lists of variable length, and dictionaries.
                _ => return reader.skip_value(),
            };
            attributes.extend(attribute);
            if attributes.len() > MOST_ATTRIBUTES {
                return Err(reader.json.fault(format!("more than {MOST_ATTRIBUTES} attributes")));
            }
            Ok(())
        })?;
        Ok(attributes)
    }

    /// Processes lists of pairs; `take` reads both values.
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
                other => return Err(self.json.fault(format!("{} among {what}", shown(&other)))),
            }
            match self.json.next()? {
                JsonEvent::End => {}
                other => {
                    return Err(self.json.fault(format!("{} in a pair of {what}", shown(&other))));
                }
            }
        }
    }

    fn numeric(
        &mut self,
        name: Rc<str>,
        points: u64,
    ) -> Result<Option<HoudiniAttribute>, ReadFault> {
        let mut values = None;
        self.entries("an attribute's data", |reader, key| match key {
            "values" => {
                values = reader.values(&name, points)?;
                Ok(())
            }
            _ => reader.skip_value(),
        })?;
        Ok(values.map(|values| HoudiniAttribute { name, values, texts: None }))
    }

    fn strings(
        &mut self,
        name: Rc<str>,
        points: u64,
    ) -> Result<Option<HoudiniAttribute>, ReadFault> {
        let (mut values, mut texts) = (None, Vec::new());
        self.entries("an attribute's data", |reader, key| match key {
            "indices" => {
                values = reader.values(&name, points)?;
                Ok(())
            }
            "strings" => reader.texts(&mut texts),
            _ => reader.skip_value(),
        })?;
        Ok(values.map(|values| HoudiniAttribute { name, values, texts: Some(texts) }))
    }

    fn texts(&mut self, texts: &mut Vec<Rc<str>>) -> Result<(), ReadFault> {
        match self.json.next()? {
            JsonEvent::List => {}
            JsonEvent::Numbers(JsonNumbers { count: 0, .. }) => return Ok(()),
            other => {
                return Err(self.json.fault(format!("expected texts, found {}", shown(&other))));
            }
        }
        loop {
            match self.json.next()? {
                JsonEvent::End => break,
                // One additional text shows that there are too many.
                JsonEvent::Text(text) if texts.len() <= MOST_TEXTS => texts.push(text),
                JsonEvent::Text(_) => {}
                other => return Err(self.json.fault(format!("{} among texts", shown(&other)))),
            }
        }
        Ok(())
    }

    /// The values of an attribute, one per point. `None` for an attribute without numbers per
    /// point.
    fn values(&mut self, name: &str, points: u64) -> Result<Option<PointValues>, ReadFault> {
        let (mut components, mut page) = (None, None);
        let mut storage = Storage::Scalar(Scalar::F64);
        let (mut packing, mut flags) = (Vec::new(), Vec::new());
        let (mut tuples, mut arrays, mut raw) = (None, None, None);
        self.entries("values", |reader, key| {
            match key {
                "size" => components = Some(reader.count("an attribute's size")?),
                "storage" => storage = reader.storage(name)?,
                "pagesize" => page = Some(reader.count("pagesize")?),
                "packing" => reader.each(|number| {
                    // Negative and large values are rejected below.
                    if let JsonNumber::Integer(count) = number
                        && packing.len() <= MOST_COMPONENTS as usize
                    {
                        packing.push(u64::try_from(count).unwrap_or(u64::MAX));
                    }
                })?,
                "constantpageflags" => flags = reader.page_flags()?,
                "rawpagedata" => raw = Some(reader.numbers(name, storage)?),
                "tuples" => tuples = Some(reader.tuples(name, storage)?),
                "arrays" => arrays = Some(reader.arrays(name, storage)?),
                _ => reader.skip_value()?,
            }
            Ok(())
        })?;
        let given = tuples.as_ref().map(|(components, _)| *components);
        let Some(components) = components.or(given) else { return Ok(None) };
        if !(1..=MOST_COMPONENTS).contains(&components) {
            return Ok(None);
        }
        let fault = |what: String| self.json.fault(format!("attribute {name}: {what}"));
        let wrong_count = |found: u64, expected: Option<u64>| {
            let expected =
                expected.map_or("more than can be".to_owned(), |count| count.to_string());
            fault(format!("{found} numbers for {points} points, which take {expected}"))
        };
        let all = points.checked_mul(components);
        let data = match (tuples, arrays, raw) {
            (Some((own, run)), None, None) => {
                // Without points, there is no tuple from which to take the number.
                if own != components && points > 0 {
                    return Err(fault(format!("tuples of {own} numbers, not of {components}")));
                }
                if Some(run.numbers.count) != all {
                    return Err(wrong_count(run.numbers.count, all));
                }
                ValueLayout::Tuples(run)
            }
            (None, Some(arrays), None) => {
                // Without points, there may be no arrays.
                if arrays.len() as u64 != components && !(arrays.is_empty() && points == 0) {
                    return Err(fault(format!("{} arrays for {components} numbers", arrays.len())));
                }
                if let Some(run) = arrays.iter().find(|run| run.numbers.count != points) {
                    return Err(wrong_count(run.numbers.count, Some(points)));
                }
                ValueLayout::Arrays(arrays)
            }
            (None, None, Some(run)) => {
                if packing.is_empty() {
                    packing.push(components);
                }
                if packing.iter().try_fold(0_u64, |sum, &count| sum.checked_add(count))
                    != Some(components)
                    || packing.contains(&0)
                {
                    return Err(fault(format!("packing of {packing:?} for {components} numbers")));
                }
                let Some(size) = page.filter(|&size| size > 0) else {
                    return Err(fault("pages without a pagesize".to_owned()));
                };
                if flags.is_empty() {
                    flags.resize_with(packing.len(), || (0, Vec::new()));
                }
                let pages = points.div_ceil(size);
                if flags.len() != packing.len()
                    || flags.iter().any(|(count, _)| *count != 0 && *count != pages)
                {
                    let counts: Vec<u64> = flags.iter().map(|(count, _)| *count).collect();
                    return Err(fault(format!(
                        "constant flags of {counts:?} pages, not of {pages}"
                    )));
                }
                let groups = packing.into_iter().zip(flags);
                let groups = groups
                    .map(|(components, (_, constant))| ComponentGroup { components, constant });
                let pages = PointPages { run, size, groups: groups.collect() };
                let expected = pages.count(points);
                if Some(run.numbers.count) != expected {
                    return Err(wrong_count(run.numbers.count, expected));
                }
                ValueLayout::Pages(pages)
            }
            (None, None, None) => return Ok(None),
            _ => return Err(fault("several arrangements of its values".to_owned())),
        };
        Ok(Some(PointValues { components, data }))
    }

    fn storage(&mut self, name: &str) -> Result<Storage, ReadFault> {
        let storage = self.text("an attribute's storage")?;
        Ok(match &*storage {
            "fpreal16" => Storage::Half,
            "fpreal32" => Storage::Scalar(Scalar::F32),
            "fpreal64" => Storage::Scalar(Scalar::F64),
            "int8" => Storage::Scalar(Scalar::I8),
            "int16" => Storage::Scalar(Scalar::I16),
            "int32" => Storage::Scalar(Scalar::I32),
            "int64" => Storage::Scalar(Scalar::I64),
            "uint8" | "bool" => Storage::Scalar(Scalar::U8),
            "uint16" => Storage::Scalar(Scalar::U16),
            other => {
                let what = format!("attribute {name} has the unknown storage {other:?}");
                return Err(self.json.fault(what));
            }
        })
    }

    /// The number of flags and their bits, for each group of components.
    fn page_flags(&mut self) -> Result<Vec<(u64, Vec<u64>)>, ReadFault> {
        match self.json.next()? {
            JsonEvent::List => {}
            JsonEvent::Numbers(JsonNumbers { count: 0, .. }) => return Ok(Vec::new()),
            other => {
                let what = format!("expected constantpageflags, found {}", shown(&other));
                return Err(self.json.fault(what));
            }
        }
        let (bytes, endian) = self.document;
        let mut groups = Vec::new();
        loop {
            let (mut count, mut bits) = (0_u64, Vec::new());
            let left = MOST_FLAGS - self.flag_words;
            let mut take = |number: JsonNumber| {
                let word = (count / 64) as usize;
                if word < left {
                    if word == bits.len() {
                        bits.push(0);
                    }
                    let truth = number != JsonNumber::Integer(0);
                    bits[word] |= u64::from(truth) << (count % 64);
                }
                count += 1;
            };
            match self.json.next()? {
                JsonEvent::End => return Ok(groups),
                JsonEvent::Numbers(numbers) => numbers.each(bytes, endian, |number| {
                    take(number);
                    Ok(())
                })?,
                JsonEvent::List => loop {
                    match self.json.next()? {
                        JsonEvent::End => break,
                        JsonEvent::Bool(truth) => take(JsonNumber::Integer(truth.into())),
                        JsonEvent::Integer(whole) => take(JsonNumber::Integer(whole)),
                        other => {
                            let what = format!("{} among constantpageflags", shown(&other));
                            return Err(self.json.fault(what));
                        }
                    }
                },
                other => {
                    let what = format!("{} among constantpageflags", shown(&other));
                    return Err(self.json.fault(what));
                }
            }
            self.flag_words += bits.len();
            if count.div_ceil(64) > bits.len() as u64 || groups.len() as u64 == MOST_COMPONENTS {
                return Err(self.json.fault("too many constantpageflags".to_owned()));
            }
            groups.push((count, bits));
        }
    }

    /// Lists with one number for each component, and the number of components.
    fn tuples(&mut self, name: &str, storage: Storage) -> Result<(u64, NumberRun), ReadFault> {
        if self.json.next()? != JsonEvent::List {
            return Err(self.json.fault(format!("attribute {name}: expected a list of tuples")));
        }
        let mut all: Option<(u64, NumberRun)> = None;
        loop {
            let first = match self.json.next()? {
                JsonEvent::End => {
                    return Ok(all.unwrap_or((
                        0,
                        NumberRun { place: NumberLocation::Gathered, ..NumberRun::NONE },
                    )));
                }
                first => first,
            };
            let NumberRun { place, numbers } = match self.numbers_from(first, name, storage)? {
                NumberRun { place: NumberLocation::Document, numbers } => self.gather(numbers)?,
                gathered => gathered,
            };
            match &mut all {
                None => all = Some((numbers.count, NumberRun { place, numbers })),
                Some((components, run)) => {
                    let own = run.numbers;
                    let end = own.part(own.count, 0).at;
                    if numbers.at != end
                        || numbers.storage != own.storage
                        || numbers.count != *components
                    {
                        let what = format!("attribute {name}: its tuples differ in type or length");
                        return Err(self.json.fault(what));
                    }
                    run.numbers.count += numbers.count;
                }
            }
        }
    }

    /// A list of numbers for each component.
    fn arrays(&mut self, name: &str, storage: Storage) -> Result<Vec<NumberRun>, ReadFault> {
        let mut arrays = Vec::new();
        match self.json.next()? {
            JsonEvent::List => {}
            JsonEvent::Numbers(JsonNumbers { count: 0, .. }) => return Ok(arrays),
            _ => {
                return Err(self
                    .json
                    .fault(format!("attribute {name}: expected a list of arrays")));
            }
        }
        loop {
            let first = match self.json.next()? {
                JsonEvent::End => return Ok(arrays),
                _ if arrays.len() as u64 == MOST_COMPONENTS => {
                    return Err(self.json.fault(format!("attribute {name}: too many arrays")));
                }
                first => first,
            };
            arrays.push(self.numbers_from(first, name, storage)?);
        }
    }

    /// Counts primitives by their kinds, and marks the vertices of particle systems.
    fn primitives(&mut self, head: &mut GeometryHead) -> Result<(), ReadFault> {
        let vertices = head.vertex_points.map_or(0, |run| run.numbers.count);
        self.pairs("the primitives", |reader| {
            let (mut kind, mut of_run) = (None, None);
            reader.entries("a primitive's kind", |reader, key| {
                match key {
                    "type" => kind = Some(reader.text("a primitive's type")?),
                    "runtype" => of_run = Some(reader.text("a primitive's type")?),
                    _ => reader.skip_value()?,
                }
                Ok(())
            })?;
            let kind =
                kind.ok_or_else(|| reader.json.fault("a primitive without a type".to_owned()))?;
            let mut count = 1;
            let (kind, is_run) = match of_run {
                Some(of_run) if &*kind == "run" => (of_run, true),
                _ => (kind, false),
            };
            let is_particles = &*kind == "Part";
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
                let is_known = head.kinds.len() < MOST_KINDS || head.kinds.contains_key(&kind);
                let kind = if is_known { kind } else { "other".into() };
                let all = head.kinds.entry(kind).or_default();
                *all = all.saturating_add(count);
            }
            Ok(())
        })
    }

    /// The number of values in a list, which are skipped.
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

/// The description of an event for a message.
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
