//! Reads attributes of points: their definitions, and how their numbers are arranged.

use std::rc::Rc;

use super::{
    ComponentGroup, HoudiniAttribute, MOST_COMPONENTS, MOST_TEXTS, NumberLocation, NumberRun,
    PointPages, PointValues, SchemaReader, ValueLayout, shown,
};
use crate::io::ReadFault;
use crate::io::columns::Scalar;
use crate::io::houdini::json::{JsonEvent, JsonNumber, JsonNumbers, Storage};

/// Maximum number of attributes. Production files have a few hundred.
const MOST_ATTRIBUTES: usize = 1 << 16;
/// Maximum length, in bytes, of an attribute's name.
const LONGEST_NAME: usize = 1 << 10;
/// Maximum number of 64-bit words, across all attributes, for the flags of constant pages. They
/// suffice for 2^26 pages, usually of 1024 points each.
const MOST_FLAGS: usize = 1 << 20;

impl SchemaReader<'_, '_, '_> {
    /// Reads the definitions of attributes and their data.
    pub(super) fn attributes(&mut self, points: u64) -> Result<Vec<HoudiniAttribute>, ReadFault> {
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
            let missing = || reader.json.fault("an attribute has no name or type".to_owned());
            let (kind, name) = kind.zip(name).ok_or_else(missing)?;
            if name.len() > LONGEST_NAME {
                let what = format!("the name of an attribute is too long: {} bytes", name.len());
                return Err(reader.json.fault(what));
            }
            let attribute = match &*kind {
                "numeric" => reader.numeric(name, points)?,
                "string" => reader.strings(name, points)?,
                // Skip lists of variable length and dictionaries.
                _ => return reader.skip_value(),
            };
            attributes.extend(attribute);
            if attributes.len() > MOST_ATTRIBUTES {
                let what = format!("there are more than {MOST_ATTRIBUTES} attributes");
                return Err(reader.json.fault(what));
            }
            Ok(())
        })?;
        Ok(attributes)
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
                return Err(self.json.fault(format!("expected strings, found {}", shown(&other))));
            }
        }
        loop {
            match self.json.next()? {
                JsonEvent::End => break,
                // Keep one text more than the maximum, so that the length of the list shows that
                // there are too many.
                JsonEvent::Text(text) if texts.len() <= MOST_TEXTS => texts.push(text),
                JsonEvent::Text(_) => {}
                other => {
                    let what = format!("expected a string, found {}", shown(&other));
                    return Err(self.json.fault(what));
                }
            }
        }
        Ok(())
    }

    /// Reads the values of an attribute, one per point. `None` if the attribute has no numbers, or
    /// too many components.
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
                    // Negative and large counts are rejected after all counts are read.
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
        let tuple_components = tuples.as_ref().map(|(components, _)| *components);
        let Some(components) = components.or(tuple_components) else { return Ok(None) };
        if !(1..=MOST_COMPONENTS).contains(&components) {
            return Ok(None);
        }
        let fault = |what: String| self.json.fault(format!("attribute {name}: {what}"));
        let wrong_count = |found: u64, expected: Option<u64>| {
            let expected = expected.map_or("2^64 or more".to_owned(), |count| count.to_string());
            fault(format!("it has {found} numbers for {points} points, expected {expected}"))
        };
        let all = points.checked_mul(components);
        let data = match (tuples, arrays, raw) {
            (Some((own, run)), None, None) => {
                // A geometry without points has no tuple that shows the number of components.
                if own != components && points > 0 {
                    return Err(fault(format!(
                        "its tuples have {own} numbers, expected {components}"
                    )));
                }
                if Some(run.numbers.count) != all {
                    return Err(wrong_count(run.numbers.count, all));
                }
                ValueLayout::Tuples(run)
            }
            (None, Some(arrays), None) => {
                // A geometry without points may have no arrays.
                if arrays.len() as u64 != components && !(arrays.is_empty() && points == 0) {
                    return Err(fault(format!(
                        "it has {} arrays, expected {components}",
                        arrays.len()
                    )));
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
                    return Err(fault(format!(
                        "its packing {packing:?} does not fit {components} numbers"
                    )));
                }
                let Some(size) = page.filter(|&size| size > 0) else {
                    return Err(fault("its pages have no pagesize".to_owned()));
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
                        "its constantpageflags are for {counts:?} pages, expected {pages}"
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
            _ => return Err(fault("it stores its values in several ways".to_owned())),
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

    /// Reads the flags of constant pages. For each group of components, returns the number of flags
    /// and the flags as bits.
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
            let remaining_words = MOST_FLAGS - self.flag_words;
            let mut take = |number: JsonNumber| {
                let word = (count / 64) as usize;
                if word < remaining_words {
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
                            let what = format!("constantpageflags contains {}", shown(&other));
                            return Err(self.json.fault(what));
                        }
                    }
                },
                other => {
                    let what = format!("constantpageflags contains {}", shown(&other));
                    return Err(self.json.fault(what));
                }
            }
            self.flag_words += bits.len();
            if count.div_ceil(64) > bits.len() as u64 || groups.len() as u64 == MOST_COMPONENTS {
                return Err(self.json.fault("constantpageflags has too many flags".to_owned()));
            }
            groups.push((count, bits));
        }
    }

    /// Reads tuples, which are lists with one number per component. Also returns the number of
    /// components.
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

    /// Reads arrays, which are lists of numbers, one list per component.
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
}
