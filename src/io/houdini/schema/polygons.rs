//! Reads polygons. Houdini stores them in three forms: one by one with a list of vertices, in runs
//! with a list of vertices for each polygon, and in runs of consecutive vertices.

use std::rc::Rc;

use super::{SchemaReader, shown};
use crate::io::ReadFault;
use crate::io::houdini::json::{JsonEvent, JsonNumber, JsonNumbers, Storage};

/// The closed polygons of a geometry.
#[derive(Debug, Default)]
pub struct Polygons {
    /// The corners of all polygons, one polygon after another, as numbers of vertices.
    corners: Vec<u32>,
    /// The end of each polygon in `corners`.
    ends: Vec<usize>,
}

impl Polygons {
    /// The corners of each polygon, as numbers of vertices.
    pub fn iter(&self) -> impl Iterator<Item = &[u32]> {
        let starts = [0].into_iter().chain(self.ends.iter().copied());
        starts.zip(&self.ends).map(|(start, &end)| &self.corners[start..end])
    }

    /// Ends a polygon after the corners that were added since the end of the last one.
    fn end(&mut self) {
        self.ends.push(self.corners.len());
    }

    /// Removes the corners that were added since the end of the last polygon.
    fn abandon(&mut self) {
        self.corners.truncate(self.ends.last().copied().unwrap_or(0));
    }
}

/// The fields that the polygons of a run have in common.
#[derive(Debug, Default)]
pub(super) struct RunFields {
    /// The names of the fields that each polygon stores, in their order.
    pub(super) varying: Vec<Rc<str>>,
    /// Whether all polygons are closed, if the file says so for the whole run.
    pub(super) closed: Option<bool>,
}

impl SchemaReader<'_, '_, '_> {
    /// Reads the value of an entry in the description of a run. Without need for polygons, the
    /// value is skipped.
    pub(super) fn field_of_run(
        &mut self,
        key: &str,
        fields: &mut RunFields,
    ) -> Result<(), ReadFault> {
        match key {
            "varyingfields" if self.polygons.is_some() => fields.varying = self.names(key)?,
            "uniformfields" if self.polygons.is_some() => {
                self.entries(key, |reader, key| reader.truth_of_closed(key, &mut fields.closed))?;
            }
            _ => self.skip_value()?,
        }
        Ok(())
    }

    /// Reads a list of names.
    fn names(&mut self, what: &str) -> Result<Vec<Rc<str>>, ReadFault> {
        match self.json.next()? {
            JsonEvent::List => {}
            JsonEvent::Numbers(JsonNumbers { count: 0, .. }) => return Ok(Vec::new()),
            other => {
                let what = format!("expected a list for {what}, found {}", shown(&other));
                return Err(self.json.fault(what));
            }
        }
        let mut names = Vec::new();
        loop {
            match self.json.next()? {
                JsonEvent::End => return Ok(names),
                // A primitive has a few fields. More are never used.
                JsonEvent::Text(name) if names.len() < 64 => names.push(name),
                JsonEvent::Text(_) => {}
                other => {
                    let what = format!("{what} contains {}", shown(&other));
                    return Err(self.json.fault(what));
                }
            }
        }
    }

    /// Reads the value of the entry `closed`, and skips the value of any other entry.
    pub(super) fn truth_of_closed(
        &mut self,
        key: &str,
        closed: &mut Option<bool>,
    ) -> Result<(), ReadFault> {
        if key != "closed" {
            return self.skip_value();
        }
        match self.json.next()? {
            JsonEvent::Bool(value) => *closed = Some(value),
            JsonEvent::Integer(value) => *closed = Some(value != 0),
            other => return Err(self.json.fault(format!("{key} cannot be {}", shown(&other)))),
        }
        Ok(())
    }

    /// Reads the data of a single polygon, or of a run of consecutive vertices. `vertices` is the
    /// number of vertices of the geometry. Returns the number of polygons.
    pub(super) fn polygons(&mut self, kind: &str, vertices: u64) -> Result<u64, ReadFault> {
        if kind == "Poly" {
            let (mut closed, mut lists) = (None, 0);
            self.entries("a polygon", |reader, key| match key {
                "vertex" => {
                    lists += 1;
                    reader.corners(vertices)
                }
                _ => reader.truth_of_closed(key, &mut closed),
            })?;
            self.require_one_list(lists)?;
            self.end_polygon(closed);
            return Ok(1);
        }
        let (mut first, mut count) = (0, 0);
        let (mut sizes, mut is_rle) = (Vec::new(), false);
        self.entries("a run of polygons", |reader, key| {
            match key {
                "startvertex" | "s_v" => first = reader.count(key)?,
                "nprimitives" | "n_p" => count = reader.count(key)?,
                "nvertices" | "n_v" | "nvertices_rle" | "r_v" => {
                    is_rle = matches!(key, "nvertices_rle" | "r_v");
                    sizes.clear();
                    let most = vertices.saturating_mul(2).saturating_add(2);
                    reader.whole_numbers(key, most, |size| sizes.push(size))?;
                }
                _ => reader.skip_value()?,
            }
            Ok(())
        })?;
        // Pairs of a number of corners and a number of polygons.
        let pair = |pair: &[u64]| match *pair {
            [size, repeated] => [size, repeated],
            [size] if !is_rle => [size, 1],
            _ => [u64::MAX; 2],
        };
        let pairs = || sizes.chunks(if is_rle { 2 } else { 1 }).map(pair);
        let sum = |of: &dyn Fn([u64; 2]) -> Option<u64>| {
            pairs().try_fold(0_u64, |sum, pair| sum.checked_add(of(pair)?))
        };
        let corners = sum(&|[size, repeated]| size.checked_mul(repeated));
        let end = corners.and_then(|corners| corners.checked_add(first));
        // Every vertex is the corner of one polygon.
        let known = self.polygons.as_ref().map_or(0, |polygons| polygons.corners.len() as u64);
        let all = corners.and_then(|corners| corners.checked_add(known));
        if sum(&|[_, repeated]| Some(repeated)) != Some(count)
            || end.is_none_or(|end| end > vertices)
            || all.is_none_or(|all| all > vertices)
        {
            let what = format!(
                "a run of {count} polygons does not fit the {vertices} vertices of the geometry"
            );
            return Err(self.json.fault(what));
        }
        let Some(polygons) = &mut self.polygons else { return Ok(count) };
        let mut next = first as u32;
        // Polygons without corners have no surface.
        for [size, repeated] in pairs().filter(|[size, _]| *size > 0) {
            for _ in 0..repeated {
                polygons.corners.extend(next..next + size as u32);
                polygons.end();
                next += size as u32;
            }
        }
        Ok(count)
    }

    /// Returns an error unless a polygon has exactly one list of corners.
    fn require_one_list(&self, lists: usize) -> Result<(), ReadFault> {
        match lists {
            1 => Ok(()),
            _ => Err(self.json.fault(format!("a polygon has {lists} lists of vertices, not 1"))),
        }
    }

    /// Reads the data of a run that lists the fields of each polygon. Returns the number of
    /// polygons.
    pub(super) fn run_of_polygons(
        &mut self,
        fields: &RunFields,
        vertices: u64,
    ) -> Result<u64, ReadFault> {
        self.require_one_list(fields.varying.iter().filter(|field| &***field == "vertex").count())?;
        match self.json.next()? {
            JsonEvent::List => {}
            JsonEvent::Numbers(JsonNumbers { count: 0, .. }) => return Ok(0),
            other => {
                let what = format!("expected a list of polygons, found {}", shown(&other));
                return Err(self.json.fault(what));
            }
        }
        let mut count = 0;
        loop {
            match self.json.next()? {
                JsonEvent::End => return Ok(count),
                JsonEvent::List => {}
                other => {
                    let what = format!("a run of polygons contains {}", shown(&other));
                    return Err(self.json.fault(what));
                }
            }
            let mut closed = fields.closed;
            for field in &fields.varying {
                match &**field {
                    "vertex" => self.corners(vertices)?,
                    key => self.truth_of_closed(key, &mut closed)?,
                }
            }
            if self.json.next()? != JsonEvent::End {
                return Err(self.json.fault("a polygon of a run has too many fields".to_owned()));
            }
            self.end_polygon(closed);
            count += 1;
        }
    }

    /// Ends the current polygon, unless it is open.
    fn end_polygon(&mut self, closed: Option<bool>) {
        let Some(polygons) = &mut self.polygons else { return };
        match closed {
            Some(false) => polygons.abandon(),
            Some(true) | None => polygons.end(),
        }
    }

    /// Reads the corners of a polygon.
    fn corners(&mut self, vertices: u64) -> Result<(), ReadFault> {
        let mut invalid = None;
        let mut polygons = self.polygons.take().unwrap_or_default();
        // Every vertex is the corner of one polygon.
        let most = vertices.saturating_sub(polygons.corners.len() as u64);
        self.whole_numbers("a polygon", most, |vertex| {
            if vertex < vertices {
                polygons.corners.push(vertex as u32);
            } else {
                invalid = invalid.or(Some(vertex));
            }
        })?;
        self.polygons = Some(polygons);
        match invalid {
            None => Ok(()),
            Some(vertex) => Err(self.json.fault(format!(
                "a polygon has vertex {vertex}, but there are {vertices} vertices, numbered from 0"
            ))),
        }
    }

    /// Calls `take` with each number of a list. The list must contain at most `most` numbers, all
    /// of them whole and not negative.
    fn whole_numbers(
        &mut self,
        what: &str,
        most: u64,
        mut take: impl FnMut(u64),
    ) -> Result<(), ReadFault> {
        let (bytes, endian) = self.document;
        let mut count = 0;
        let mut check = |number: JsonNumber| -> Result<(), String> {
            count += 1;
            match number {
                _ if count > most => Err(format!("{what} has too many numbers for the geometry")),
                JsonNumber::Integer(whole @ 0..) => {
                    take(whole as u64);
                    Ok(())
                }
                number => Err(format!("{what} contains {number}, not a whole number from 0")),
            }
        };
        let checked = match self.json.next()? {
            JsonEvent::Numbers(JsonNumbers { storage: Storage::Bits, .. }) => {
                Err(format!("{what} cannot be an array of booleans"))
            }
            JsonEvent::Numbers(numbers) => {
                let mut checked = Ok(());
                numbers.each(bytes, endian, |number| {
                    if checked.is_ok() {
                        checked = check(number);
                    }
                    Ok(())
                })?;
                checked
            }
            JsonEvent::List => loop {
                let checked = match self.json.next()? {
                    JsonEvent::End => break Ok(()),
                    JsonEvent::Integer(whole) => check(JsonNumber::Integer(whole)),
                    JsonEvent::Real(real) => check(JsonNumber::Real(real)),
                    other => Err(format!("{what} contains {}", shown(&other))),
                };
                if checked.is_err() {
                    break checked;
                }
            },
            other => Err(format!("expected numbers for {what}, found {}", shown(&other))),
        };
        checked.map_err(|what| self.json.fault(what))
    }
}
