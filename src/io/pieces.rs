//! Concatenates the particles of an input that consists of one or several pieces, without ghosts.
//!
//! A simulation on many nodes writes one piece per node. A piece may contain flagged copies of
//! particles of other nodes, called ghosts. A span is a range of consecutive rows without ghosts.
//! The particles are the spans of all pieces in order.

use std::collections::{HashMap, HashSet};
use std::ops::Range;
use std::sync::Arc;

use crate::particles::sieve::Sieve;
use crate::particles::sizes::SPACING;
use crate::particles::{
    AttributeInfo, AttributeKind, Label, Particles, RereadError, velocity_attribute,
};

use super::columns::ColumnStore;
use super::wanted::WantedPieces;
use super::windows::WindowPool;
use super::{ParticleFile, ReadFault, UnreadPart, malformed};

/// Number of flags that are read per batch.
const FLAGS: usize = 1 << 14;

/// The particles of all pieces.
#[derive(Debug, Default)]
pub struct Pieces {
    stores: Vec<ColumnStore>,
    /// The spans in the order of their particles. Together, they contain all particles.
    spans: Vec<Span>,
    len: usize,
    infos: Vec<AttributeInfo>,
    /// The text attributes, if there is only one piece.
    labels: Vec<Label>,
    /// For every piece, the source of each attribute in `infos`.
    sources: Vec<Vec<Source>>,
    /// For every piece that contains particles, its number in the input.
    of_input: Vec<usize>,
}

/// The source of an attribute in a piece.
#[derive(Debug, Clone, Copy)]
enum Source {
    /// The piece's attribute with this number.
    Attribute(usize),
    /// All particles of the piece have this value.
    Constant(f32),
}

/// Consecutive particles of one piece.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PieceChunk {
    /// The number of the piece in the input, which also counts pieces without particles.
    pub piece: usize,
    /// The number of particles in the chunk.
    pub count: usize,
}

/// A range of consecutive rows of one piece, without ghosts.
#[derive(Debug, Clone, Copy)]
struct Span {
    /// The index of the span's first particle among the particles of all pieces.
    first: usize,
    /// The number of the piece among the pieces with particles.
    piece: usize,
    /// The row of the span's first particle in the piece.
    row: usize,
}

impl From<ColumnStore> for Pieces {
    fn from(store: ColumnStore) -> Self {
        let (infos, labels) = (store.attributes().to_vec(), store.labels().to_vec());
        let sources = vec![(0..infos.len()).map(Source::Attribute).collect()];
        let len = store.len();
        let spans = vec![Span { first: 0, piece: 0, row: 0 }];
        Self { stores: vec![store], spans, len, infos, labels, sources, of_input: vec![0] }
    }
}

impl Pieces {
    /// Joins pieces, whose attributes must have the same names and numbers of components.
    ///
    /// Attributes may have any order and number type, and a piece without particles may lack
    /// attributes. Colours in integers become fractions from 0 to 1 if another piece has
    /// floating-point colours. Text attributes are kept only if there is a single piece.
    ///
    /// # Errors
    /// The number of the first piece whose attributes differ from those of the pieces before it,
    /// with [`ReadFault::Malformed`].
    pub fn join(parts: Vec<Self>) -> Result<Self, (usize, ReadFault)> {
        let with_attributes = || parts.iter().find(|part| !part.infos.is_empty());
        let filled = parts.iter().find(|part| !part.is_empty()).or_else(with_attributes);
        let infos = filled.map_or_else(Vec::new, |part| part.infos.clone());
        let labels = match &parts[..] {
            [only] => only.labels.clone(),
            _ => Vec::new(),
        };
        let mut all = Self { infos, labels, ..Self::default() };
        for (index, part) in parts.into_iter().enumerate().filter(|(_, part)| !part.is_empty()) {
            let order = same_attributes(&all.infos, &part.infos).map_err(|fault| (index, fault))?;
            for (info, &number) in all.infos.iter_mut().zip(&order) {
                info.kind = info.kind.together(part.infos[number].kind);
            }
            let (first, piece) = (all.len, all.stores.len());
            let moved =
                |span: Span| Span { first: first + span.first, piece: piece + span.piece, ..span };
            all.spans.extend(part.spans.into_iter().map(moved));
            let sources = part.sources.iter();
            all.sources.extend(
                sources.map(|old| order.iter().map(|&number| old[number]).collect::<Vec<_>>()),
            );
            all.of_input.resize(piece + part.stores.len(), index);
            all.stores.extend(part.stores);
            all.len += part.len;
        }
        let pool = Arc::default();
        all.stores.iter_mut().for_each(|store| store.share(&pool));
        Ok(all)
    }

    /// Adds an attribute with one value for all particles, unless an attribute with this name
    /// exists.
    fn with_constant(mut self, name: &str, value: f32) -> Self {
        if self.infos.iter().all(|info| info.name != name) {
            self.infos.push(AttributeInfo::new(name, 1));
            self.sources.iter_mut().for_each(|sources| sources.push(Source::Constant(value)));
        }
        self
    }

    /// Removes the particles whose scalar attribute number `flags` is nonzero, and then removes
    /// this attribute. Returns the number of removed particles.
    pub(super) fn remove_flagged(&mut self, flags: usize) -> usize {
        let (mut spans, mut len) = (Vec::new(), 0);
        let mut values = vec![0.0; FLAGS];
        self.each_span(0..self.len, |span, count, _| {
            let mut kept_before = false;
            for first in (0..count).step_by(FLAGS) {
                let values = &mut values[..FLAGS.min(count - first)];
                self.read(flags, (span.piece, span.row + first), values);
                for (row, &flag) in (span.row + first..).zip(&*values) {
                    let kept = flag == 0.0;
                    if kept && !kept_before {
                        spans.push(Span { first: len, piece: span.piece, row });
                    }
                    len += usize::from(kept);
                    kept_before = kept;
                }
            }
        });
        let dropped = self.len - len;
        spans.shrink_to_fit();
        (self.spans, self.len) = (spans, len);
        self.remove_attribute(flags);
        dropped
    }

    /// Removes the attributes for which `keep` returns false.
    pub(super) fn retain_attributes(&mut self, keep: impl Fn(&AttributeInfo) -> bool) {
        for number in (0..self.infos.len())
            .rev()
            .filter(|&number| !keep(&self.infos[number]))
            .collect::<Vec<_>>()
        {
            self.remove_attribute(number);
        }
    }

    /// Gives the velocity the name `name`. Does nothing if there is no velocity, or if another
    /// attribute has this name.
    fn rename_velocity(&mut self, name: &str) {
        if self.infos.iter().all(|info| info.name != name)
            && let Some(velocity) = velocity_attribute(&self.infos)
        {
            name.clone_into(&mut self.infos[velocity].name);
        }
    }

    fn remove_attribute(&mut self, number: usize) {
        self.infos.remove(number);
        for sources in &mut self.sources {
            sources.remove(number);
        }
    }

    /// Divides the particles of each piece into chunks of at most `most` particles.
    ///
    /// # Panics
    /// If `most` is 0.
    pub fn chunks(&self, most: usize) -> Vec<PieceChunk> {
        let mut counts = vec![0; self.stores.len()];
        self.each_span(0..self.len, |span, count, _| counts[span.piece] += count);
        let chunks = counts.into_iter().zip(&self.of_input).flat_map(|(all, &piece)| {
            (0..all)
                .step_by(most)
                .map(move |first| PieceChunk { piece, count: most.min(all - first) })
        });
        chunks.collect()
    }

    /// Keeps only the particles in `ranges`, which must be in ascending order.
    pub fn keep(&mut self, ranges: impl IntoIterator<Item = Range<usize>>) {
        let (mut spans, mut len) = (Vec::<Span>::new(), 0);
        for range in ranges {
            self.each_span(range, |span, count, _| {
                spans.push(Span { first: len, ..span });
                len += count;
            });
        }
        (self.spans, self.len) = (spans, len);
    }

    /// Keeps only the particles that `sieve` selects.
    pub(super) fn select(&mut self, sieve: &Sieve) {
        let stores = self.stores.iter().map(|store| Sieve::none(store.len()));
        let mut kept: Vec<Vec<u64>> = stores.collect();
        self.each_span(0..self.len, |span, count, first| {
            let selected = (first..first + count).filter(|&particle| sieve.holds(particle));
            selected.for_each(|p| Sieve::set(&mut kept[span.piece], span.row + (p - first)));
        });
        (self.spans, self.len) = (Vec::new(), 0);
        for (piece, (store, words)) in self.stores.iter_mut().zip(kept).enumerate() {
            store.select(Sieve::new(words));
            if !store.is_empty() {
                self.spans.push(Span { first: self.len, piece, row: 0 });
                self.len += store.len();
            }
        }
    }

    /// Number of bytes in scratch files.
    pub fn scratch_bytes(&self) -> u64 {
        self.stores.iter().map(ColumnStore::scratch_bytes).sum()
    }

    /// Whether attribute number `index` is a colour that `piece` stores as integers from 0 to 255,
    /// while another piece stores it as fractions. The integers are then divided by 255.
    fn is_scaled_to_fractions(&self, piece: usize, index: usize) -> bool {
        let Source::Attribute(number) = self.sources[piece][index] else { return false };
        let stored = &self.stores[piece].attributes()[number];
        self.infos[index].kind == AttributeKind::Colour
            && stored.kind.is_colour()
            && stored.kind != AttributeKind::Colour
    }

    /// Reads attribute number `index` of a piece, from row `row` on.
    fn read(&self, index: usize, (piece, row): (usize, usize), out: &mut [f32]) {
        match self.sources[piece][index] {
            Source::Attribute(number) => self.stores[piece].attribute(number, row, out),
            Source::Constant(value) => out.fill(value),
        }
        if self.is_scaled_to_fractions(piece, index) {
            out.iter_mut().for_each(|value| *value /= 255.0);
        }
    }

    /// Calls `take` for each span within `range`, clipped to `range`. Passes the span, its number
    /// of particles, and the offset of its first particle from the start of `range`.
    fn each_span(&self, range: Range<usize>, mut take: impl FnMut(Span, usize, usize)) {
        assert!(range.end <= self.len, "range {range:?} of {} particles", self.len);
        let mut first = range.start;
        let mut index = self.spans.partition_point(|span| span.first <= first).saturating_sub(1);
        while first < range.end {
            let span = self.spans[index];
            let end = self.spans.get(index + 1).map_or(self.len, |next| next.first).min(range.end);
            let cut = Span { first, row: span.row + (first - span.first), ..span };
            take(cut, end - first, first - range.start);
            (first, index) = (end, index + 1);
        }
    }
}

/// Joins files into one set of particles, in order, with the attributes that all of them have. The
/// first opened file determines the format, the unit and the types of particles. The velocity has
/// the name that it has in the first file with a velocity.
///
/// `None` stands for a file that was not opened, or that holds no particles. It counts as a piece
/// without particles.
///
/// If the files have different spacings, like the zones of a simulation with variable resolution,
/// each particle gets the spacing of its file as the attribute `spacing`. Each particle also gets
/// this attribute if `wanted` selects only some of the files. In both cases, the attribute is added
/// only if every file with particles has a spacing.
///
/// # Errors
/// The number of the first file that cannot be joined with the files before it, and the reason.
pub(super) fn join_files(
    mut files: Vec<Option<ParticleFile>>,
    wanted: WantedPieces,
) -> Result<ParticleFile, (usize, ReadFault)> {
    let spacings: Vec<f64> = files.iter().flatten().filter_map(|file| file.spacing).collect();
    let differ = spacings.windows(2).any(|two| two[0] != two[1]);
    let is_known = |file: &ParticleFile| file.spacing.is_some() || file.particles.is_empty();
    if (differ || matches!(wanted, WantedPieces::Numbered(_)))
        && files.iter().flatten().all(is_known)
    {
        for file in files.iter_mut().flatten() {
            if let Some(spacing) = file.spacing {
                let particles = std::mem::take(&mut file.particles);
                file.particles = particles.with_constant(SPACING, spacing as f32);
            }
        }
    }
    unify_velocity_names(&mut files);
    let partial = remove_unshared_attributes(&mut files).into_iter().map(UnreadPart::Attribute);
    let opened = || files.iter().flatten();
    let blocks = opened().flat_map(|file| file.left_out.iter().cloned());
    let mut names = HashSet::new();
    let left_out = blocks
        .filter(|part| !matches!(part, UnreadPart::Attribute(_)))
        .filter(|part| part.attribute().is_none_or(|name| names.insert(name.to_owned())))
        .chain(partial)
        .collect::<Vec<_>>();
    let time = opened().find_map(|file| file.time);
    let ghosts = opened().map(|file| file.ghosts).sum();
    let unselected = opened().map(|file| file.unselected).sum();
    let is_empty = opened().all(|file| file.particles.is_empty());
    let none_selected = opened().find_map(|file| file.none_selected.clone());
    let none_selected = none_selected.filter(|_| is_empty);
    let only_lines = opened().any(|file| file.only_lines)
        && opened().all(|file| file.only_lines || file.particles.is_empty());
    let Some(first) = opened().next() else {
        return Ok(ParticleFile::new(Pieces::default(), "no file"));
    };
    let spacing = first.spacing.filter(|_| opened().all(|f| f.spacing == first.spacing));
    let box_size = first.box_size.filter(|_| opened().all(|f| f.box_size == first.box_size));
    let (format, unit_metres) = (first.format, first.unit_metres);
    let (unread, texts) = (first.unread.clone(), first.texts.clone());
    let particle_types = first.particle_types.clone();
    let particles =
        files.into_iter().map(|file| file.map_or_else(Pieces::default, |f| f.particles));
    let particles = Pieces::join(particles.collect())?;
    Ok(ParticleFile {
        particles,
        format,
        spacing,
        time,
        box_size,
        unit_metres,
        particle_types,
        ghosts,
        unselected,
        none_selected,
        unread,
        texts,
        left_out,
        only_lines,
    })
}

/// Gives the velocities of all files the same name.
fn unify_velocity_names(files: &mut [Option<ParticleFile>]) {
    let mut infos = files.iter().flatten().map(|file| file.particles.attributes());
    let first = infos.find_map(|infos| Some(infos[velocity_attribute(infos)?].name.clone()));
    let Some(name) = first else { return };
    files.iter_mut().flatten().for_each(|file| file.particles.rename_velocity(&name));
}

/// Removes and returns the attributes that at least one file with particles lacks.
fn remove_unshared_attributes(files: &mut [Option<ParticleFile>]) -> Vec<AttributeInfo> {
    let filled = || files.iter().flatten().filter(|file| !file.particles.is_empty());
    let mut partial: Vec<AttributeInfo> = Vec::new();
    for left_out in filled().flat_map(|file| file.left_out.clone()) {
        if let UnreadPart::Attribute(info) = left_out {
            partial.push(info);
        }
    }
    let key = |info: &AttributeInfo| (info.name.clone(), info.components);
    let mut counts = HashMap::new();
    for info in filled().flat_map(|file| file.particles.attributes()) {
        *counts.entry(key(info)).or_insert(0) += 1;
    }
    let all = filled().count();
    let lacks = |info: &&AttributeInfo| counts[&key(info)] < all;
    partial.extend(filled().flat_map(|f| f.particles.attributes()).filter(lacks).cloned());
    let mut partial_keys = HashSet::new();
    partial.retain(|info| partial_keys.insert(key(info)));
    for file in files.iter_mut().flatten() {
        file.particles.retain_attributes(|info| !partial_keys.contains(&key(info)));
    }
    partial
}

/// Whether two attributes have the same name and number of components. Their number types may
/// differ.
fn same(a: &AttributeInfo, b: &AttributeInfo) -> bool {
    (&a.name, a.components) == (&b.name, b.components)
}

/// For each attribute of `infos`, the index of the same attribute in `of_piece`.
fn same_attributes(
    infos: &[AttributeInfo],
    of_piece: &[AttributeInfo],
) -> Result<Vec<usize>, ReadFault> {
    let differs = |what: &str, info: &AttributeInfo| {
        let AttributeInfo { name, components, .. } = info;
        malformed(0, format!("has {what} {name} (components: {components}), unlike earlier pieces"))
    };
    if let Some(extra) = of_piece.iter().find(|info| !infos.iter().any(|other| same(info, other))) {
        return Err(differs("an attribute", extra));
    }
    let number = |info: &AttributeInfo| {
        let found = of_piece.iter().position(|other| same(other, info));
        found.ok_or_else(|| differs("no attribute", info))
    };
    infos.iter().map(number).collect()
}

impl Particles for Pieces {
    fn len(&self) -> usize {
        self.len
    }

    fn positions(&self, first: usize, out: &mut [[f64; 3]]) {
        self.each_span(first..first + out.len(), |span, count, at| {
            self.stores[span.piece].positions(span.row, &mut out[at..at + count]);
        });
    }

    fn check(&self) -> Result<(), RereadError> {
        self.stores.iter().try_for_each(Particles::check)
    }

    fn resident_bytes(&self) -> u64 {
        let files: u64 = self.stores.iter().map(ColumnStore::file_bytes).sum();
        let kept = self
            .stores
            .iter()
            .filter(|store| store.file_bytes() == 0)
            .map(Particles::resident_bytes);
        kept.sum::<u64>()
            + WindowPool::resident_bytes(files)
            + (self.spans.len() * size_of::<Span>()) as u64
            + self.stores.iter().map(ColumnStore::sieve_bytes).sum::<u64>()
    }

    fn release(&self, range: Range<usize>) {
        self.each_span(range, |span, count, _| {
            self.stores[span.piece].release(span.row..span.row + count)
        });
    }

    fn attributes(&self) -> &[AttributeInfo] {
        &self.infos
    }

    fn attribute(&self, index: usize, first: usize, out: &mut [f32]) {
        let components = self.infos[index].components;
        let count = out.len() / components.max(1);
        self.each_span(first..first + count, |span, count, at| {
            let out = &mut out[at * components..(at + count) * components];
            self.read(index, (span.piece, span.row), out);
        });
    }

    fn labels(&self) -> &[Label] {
        &self.labels
    }

    fn label(&self, index: usize, first: usize, out: &mut [u32]) {
        self.each_span(first..first + out.len(), |span, count, at| {
            self.stores[span.piece].label(index, span.row, &mut out[at..at + count]);
        });
    }

    fn component(&self, (index, component): (usize, usize), first: usize, out: &mut [f64]) {
        self.each_span(first..first + out.len(), |span, count, at| {
            let out = &mut out[at..at + count];
            match self.sources[span.piece][index] {
                Source::Attribute(number) => {
                    self.stores[span.piece].component((number, component), span.row, out);
                }
                Source::Constant(value) => out.fill(value.into()),
            }
            if self.is_scaled_to_fractions(span.piece, index) {
                out.iter_mut().for_each(|value| *value /= 255.0);
            }
        });
    }

    fn integers(&self, index: usize, first: usize, out: &mut [i64]) {
        let components = self.infos[index].components;
        let count = out.len() / components.max(1);
        self.each_span(first..first + count, |span, count, at| {
            let out = &mut out[at * components..(at + count) * components];
            match self.sources[span.piece][index] {
                Source::Attribute(number) => {
                    self.stores[span.piece].integers(number, span.row, out);
                }
                Source::Constant(value) => out.fill(value as i64),
            }
        });
    }
}
