//! Reads polygons. Houdini stores them in three forms: one by one with a list of vertices, in runs
//! with a list of vertices for each polygon, and in runs of consecutive vertices.

use std::rc::Rc;

use super::{SchemaReader, shown};
use crate::io::ReadFault;
use crate::io::houdini::json::{JsonEvent, JsonNumber, JsonNumbers};

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

/// Whether `kind` is a name of polygons. Open polygons are curves: in runs they have another name,
/// and other polygons have the field `closed`.
pub(super) fn is_polygon(kind: &str) -> bool {
    matches!(kind, "Poly" | "p_r" | "Polygon_run")
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
    fn truth_of_closed(&mut self, key: &str, closed: &mut Option<bool>) -> Result<(), ReadFault> {
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
            let mut closed = None;
            self.entries("a polygon", |reader, key| match key {
                "vertex" => reader.corners(vertices),
                _ => reader.truth_of_closed(key, &mut closed),
            })?;
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
                    let mut is_whole = true;
                    reader.each(|number| match number {
                        JsonNumber::Integer(size @ 0..) => sizes.push(size as u64),
                        _ => is_whole = false,
                    })?;
                    if !is_whole {
                        return Err(reader.json.fault(format!("{key} must be whole numbers")));
                    }
                }
                _ => reader.skip_value()?,
            }
            Ok(())
        })?;
        // Pairs of a number of corners and a number of polygons.
        let pairs: Vec<[u64; 2]> = if is_rle {
            sizes.as_chunks::<2>().0.to_vec()
        } else {
            sizes.into_iter().map(|size| [size, 1]).collect()
        };
        let sum = |of: &dyn Fn([u64; 2]) -> Option<u64>| {
            pairs.iter().try_fold(0_u64, |sum, &pair| sum.checked_add(of(pair)?))
        };
        let end = sum(&|[size, polygons]| size.checked_mul(polygons))
            .and_then(|corners| corners.checked_add(first));
        if sum(&|[_, polygons]| Some(polygons)) != Some(count)
            || end.is_none_or(|end| end > vertices)
            || pairs.iter().any(|[size, _]| *size == 0)
        {
            let what = format!(
                "a run of {count} polygons does not fit the {vertices} vertices of the geometry"
            );
            return Err(self.json.fault(what));
        }
        let Some(polygons) = &mut self.polygons else { return Ok(count) };
        let mut next = first as u32;
        for [size, repeated] in pairs {
            for _ in 0..repeated {
                polygons.corners.extend(next..next + size as u32);
                polygons.end();
                next += size as u32;
            }
        }
        Ok(count)
    }

    /// Reads the data of a run that lists the fields of each polygon. Returns the number of
    /// polygons.
    pub(super) fn run_of_polygons(
        &mut self,
        fields: &RunFields,
        vertices: u64,
    ) -> Result<u64, ReadFault> {
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
        let mut corners = std::mem::take(&mut self.polygons).unwrap_or_default();
        self.each(|number| match number {
            JsonNumber::Integer(vertex @ 0..) if (vertex as u64) < vertices => {
                corners.corners.push(vertex as u32);
            }
            number => invalid = invalid.or(Some(number)),
        })?;
        self.polygons = Some(corners);
        match invalid {
            None => Ok(()),
            Some(number) => Err(self.json.fault(format!(
                "a polygon has vertex {number}, but there are {vertices} vertices, numbered from 0"
            ))),
        }
    }
}
