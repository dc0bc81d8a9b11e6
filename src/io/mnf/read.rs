use std::cell::RefCell;
use std::fs::File;
use std::ops::{Range, RangeInclusive};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use crc32fast::Hasher;
use glam::{DVec3, IVec3};
use rayon::prelude::*;
use zstd::bulk::Decompressor;

use crate::brick::{BrickSide, Census, DifField, FrameFacts, PageInfo, PageShape, PageSource};
use crate::field::calibration::check_finest;
use crate::field::indicator::{Indicator, SampledDif};
use crate::field::sizes::{Layer, SampledOctaves, SizedClouds};
use crate::grid::units::{MeanCount, positive_length};
use crate::grid::{BIN, CELL_LIMIT, CellBox, Domain, Grid, MortonKey, Periodic};
use crate::io::bytes::{Bytes, PrivateBytes, open_bytes};
use crate::io::columns::Endian;
use crate::io::cursor::Cursor;
use crate::io::{ReadError, ReadFault, malformed};

use super::{
    END_MAGIC, ENTRY, FACTS, FIRST_VERSION, HEADER, MAGIC, PERIODIC, PackedFrame, SIZES,
    SIZES_VERSION, TAIL, WALLS, samples_from_planes,
};

/// Number of bytes that are read from the map before its memory is released.
const RELEASE_STEP: u64 = 4 << 20;
/// Number of bytes that the system maps around an accessed byte.
const FAULT_AROUND_BYTES: u64 = 64 << 10;
/// The valid densities for particles of several sizes. A density is the particles' volume per unit
/// volume.
const DENSITIES: RangeInclusive<f64> = 0.01..=100.0;
/// Number of bytes that are added to a checksum at a time.
const CHUNK: usize = 1 << 20;

/// Opens a packed frame, which may be larger than memory.
///
/// The function reads and checks every byte, but keeps only the index in memory. Samples are read
/// again when they are needed. The most recently used pages stay in memory, up to `cache_bytes`.
/// The map of the file takes a few MiB of memory at a time.
///
/// For the indicator cloud, the samples of wider cells are computed on first use. If the samples of
/// a cell width do not fit in the cache, they are stored in a scratch file in the folder `scratch`.
/// Without this folder, they are computed again when they are needed.
///
/// If another program changes the file while the field is in use, the process ends with a panic or
/// a signal.
///
/// # Errors
/// Errors of the system, [`ReadFault::Truncated`], [`ReadFault::Malformed`] and
/// [`ReadFault::Compression`] for an invalid or damaged frame, and [`ReadFault::Unsupported`] for a
/// frame of another version.
pub fn open_frame(
    path: &Path,
    cache_bytes: u64,
    scratch: Option<&Path>,
) -> Result<PackedFrame, ReadError> {
    let fail = |fault| ReadError::new(path, fault);
    let kept = match open_bytes(path)? {
        Bytes::File(file) => {
            file.file().map_err(ReadFault::from).and_then(|file| Ok(PrivateBytes::map(&file)?))
        }
        Bytes::Kept(kept) => Ok(kept),
    };
    let Index { facts, indicator, sizes, infos, pages } =
        kept.and_then(read_index).map_err(fail)?;
    pages.check(&infos).map_err(fail)?;
    let mut fields = pages.into_fields(infos, cache_bytes);
    let sampled = |facts: FrameFacts, field: DifField| {
        let sampled = SampledDif::new(facts, indicator, field);
        match scratch {
            Some(folder) => sampled.with_scratch(folder),
            None => sampled,
        }
    };
    let Some(SizeFacts { coarsest, density, .. }) = sizes else {
        return Ok(PackedFrame::Dif(sampled(facts, fields.swap_remove(0))));
    };
    let mut fields = fields.into_iter();
    let mut layers = Vec::new();
    while let (Some(volume), Some(fraction)) = (fields.next(), fields.next()) {
        let facts = facts.in_octave(layers.len() as u32);
        layers.push(Layer { volume: sampled(facts, volume), fraction: sampled(facts, fraction) });
    }
    let clouds = SizedClouds::new(layers);
    Ok(PackedFrame::Octaves(SampledOctaves { facts, clouds, coarsest, density }))
}

/// Opens a frame that this process wrote and that no other process can access. Samples are not
/// checked.
///
/// # Errors
/// The errors of [`open_frame`] that concern the index.
pub fn frame_from_file(file: &File, cache_bytes: u64) -> Result<SampledDif, ReadFault> {
    let Index { facts, indicator, infos, pages, .. } = read_index(PrivateBytes::map(file)?)?;
    let field = pages.into_fields(infos, cache_bytes).swap_remove(0);
    Ok(SampledDif::new(facts, indicator, field))
}

/// A memory map of a file. The map's memory is released whenever more than [`RELEASE_STEP`] bytes
/// have been accessed since the last release.
#[derive(Debug)]
struct MapWindow {
    bytes: PrivateBytes,
    accessed_bytes: AtomicU64,
}

impl MapWindow {
    /// Counts accessed bytes, and releases the map's memory after more than [`RELEASE_STEP`] bytes.
    /// Must be called after every access.
    fn count_access(&self, bytes: u64) {
        if self.accessed_bytes.fetch_add(bytes, Ordering::Relaxed) + bytes > RELEASE_STEP {
            self.accessed_bytes.store(0, Ordering::Relaxed);
            self.bytes.release(0..self.bytes.len());
        }
    }

    fn hash(&self, range: Range<usize>, hasher: &mut Hasher) {
        for chunk in self.bytes[range].chunks(CHUNK) {
            hasher.update(chunk);
            self.count_access(chunk.len() as u64);
        }
    }
}

/// The compressed pages of a frame.
#[derive(Debug)]
struct MappedPages {
    window: MapWindow,
    shape: PageShape,
    /// Byte offset of each page, and of the end of the last page.
    first: Vec<u64>,
    /// Number of bricks in each page.
    bricks: Vec<u8>,
    /// The number of each field's first page, and finally the total number of pages.
    fields: Vec<usize>,
    /// Checksums of the pages. They are not needed after the pages have been checked.
    checksums: Vec<u32>,
}

impl MappedPages {
    fn compressed(&self, page: usize) -> &[u8] {
        &self.window.bytes[self.first[page] as usize..self.first[page + 1] as usize]
    }

    /// Decompresses the samples of a page. `None` for a damaged zstd stream or a wrong number of
    /// samples.
    fn decompress(&self, page: usize) -> Option<Vec<u16>> {
        thread_local! {
            static SCRATCH: RefCell<(Decompressor<'static>, Vec<u8>)> = RefCell::default();
        }
        let count = usize::from(self.bricks[page]) * self.shape.brick_samples();
        SCRATCH.with_borrow_mut(|(decompressor, planes)| {
            planes.resize(count * size_of::<u16>(), 0);
            let found =
                decompressor.decompress_to_buffer(self.compressed(page), &mut planes[..]).ok()?;
            (found == planes.len()).then(|| samples_from_planes(planes))
        })
    }

    /// Checks that the samples of all pages match `infos`.
    fn check(&self, infos: &[PageInfo]) -> Result<(), ReadFault> {
        let fault = infos.par_iter().enumerate().find_map_first(|(page, info)| {
            let compressed = self.compressed(page);
            let wrong = if crc32fast::hash(compressed) != self.checksums[page] {
                Some("does not match its checksum")
            } else {
                match self.decompress(page) {
                    None => Some("does not decompress to its size"),
                    Some(samples) => {
                        let found =
                            PageInfo::from_samples(info.key, info.bricks, &samples, self.shape);
                        (found != Some(*info)).then_some("contains other cells than the index says")
                    }
                }
            };
            self.window.count_access(compressed.len() as u64);
            wrong.map(|wrong| malformed(self.first[page] as usize, format!("page {page} {wrong}")))
        });
        fault.map_or(Ok(()), Err)
    }

    /// Returns the fields. Each field gets a share of the cache in proportion to its number of
    /// pages.
    fn into_fields(mut self, mut infos: Vec<PageInfo>, cache_bytes: u64) -> Vec<DifField> {
        self.checksums = Vec::new();
        let (shape, mut starts) = (self.shape, std::mem::take(&mut self.fields));
        let all = Arc::new(self);
        let count = infos.len().max(1) as u128;
        let mut fields = Vec::with_capacity(starts.len());
        starts.pop();
        while let Some(first) = starts.pop() {
            let own = if first == 0 { std::mem::take(&mut infos) } else { infos.split_off(first) };
            let share = u128::from(cache_bytes) * own.len() as u128 / count;
            let pages = FieldPages { all: Arc::clone(&all), first };
            fields.push(DifField::paged(shape, own, Box::new(pages), share as u64));
        }
        fields.reverse();
        fields
    }
}

/// The pages of one field.
#[derive(Debug)]
struct FieldPages {
    all: Arc<MappedPages>,
    /// The number of the field's first page.
    first: usize,
}

impl PageSource for FieldPages {
    fn samples(&self, page: usize) -> Vec<u16> {
        let (all, page) = (&*self.all, self.first + page);
        let samples = all.decompress(page).expect("the file does not change after it is opened");
        all.window.count_access(all.compressed(page).len() as u64 + FAULT_AROUND_BYTES);
        samples
    }
}

/// The metadata of a frame, and the positions of its pages.
struct Index {
    facts: FrameFacts,
    indicator: Indicator,
    sizes: Option<SizeFacts>,
    infos: Vec<PageInfo>,
    pages: MappedPages,
}

/// Facts about particles of several sizes.
#[derive(Debug, Clone, Copy)]
struct SizeFacts {
    octaves: u32,
    /// The largest size.
    coarsest: f64,
    /// The particles' volume per unit volume deep in the fluid, if it is known.
    density: Option<f64>,
}

fn read_index(bytes: PrivateBytes) -> Result<Index, ReadFault> {
    let (version, side) = read_header(&bytes)?;
    let window = MapWindow { bytes, accessed_bytes: AtomicU64::new(0) };
    let footer = read_tail(&window)?;
    let mut cursor = Cursor::new(window.bytes.view(), footer, Endian::Little);
    let (facts, indicator, sizes, count) = read_facts(&mut cursor)?;
    if version == FIRST_VERSION && indicator == Indicator::Cloud {
        let what = "version 1 of the indicator cloud is not supported; pack the particles again";
        return Err(ReadFault::Unsupported(what.into()));
    }
    if sizes.is_some() != (version == SIZES_VERSION) {
        let what = format!(
            "the frame has version {version}, but its flags are the flags of another version"
        );
        return Err(malformed(footer, what));
    }
    let index = (window.bytes.len() - TAIL).checked_sub(cursor.at());
    let index = index.ok_or_else(|| malformed(footer, "the footer reaches into the tail"))?;
    if count.checked_mul(ENTRY as u64) != Some(index as u64) || u32::try_from(count).is_err() {
        let what = format!("the index has {index} bytes, which does not fit {count} pages");
        return Err(malformed(cursor.at(), what));
    }
    let count = count as usize;
    let mut infos = Vec::with_capacity(count);
    let mut first = Vec::with_capacity(count + 1);
    let mut bricks = Vec::with_capacity(count);
    let mut checksums = Vec::with_capacity(count);
    let field_count = sizes.map_or(1, |sizes| 2 * sizes.octaves);
    let mut fields = Vec::with_capacity(field_count as usize + 1);
    let mut end = HEADER as u64;
    first.push(end);
    for _ in 0..count {
        let at = cursor.at();
        let previous = infos.last().map(|info: &PageInfo| info.key);
        let entry = read_entry(&mut cursor, side, &facts, field_count)?;
        // A field without pages has no entries, so the next entry may skip its number.
        let is_first = fields.len() <= usize::from(entry.field);
        fields.resize(fields.len().max(usize::from(entry.field) + 1), infos.len());
        let is_earlier = fields.len() > usize::from(entry.field) + 1;
        if is_earlier || !is_first && previous.is_some_and(|previous| previous >= entry.info.key) {
            return Err(malformed(at, "the pages are not in order"));
        }
        if entry.offset != end || entry.length > footer as u64 - end {
            return Err(malformed(at, "a page does not start where the one before it ends"));
        }
        end += entry.length;
        infos.push(entry.info);
        first.push(end);
        bricks.push(entry.info.bricks.count_ones() as u8);
        checksums.push(entry.checksum);
        window.count_access(ENTRY as u64);
    }
    if end != footer as u64 {
        return Err(malformed(
            end as usize,
            "there are extra bytes between the last page and the footer",
        ));
    }
    fields.resize(field_count as usize + 1, infos.len());
    let full_cells: u64 = infos.iter().map(|info| u64::from(info.full_count)).sum();
    let shape = indicator.kind().shape(side);
    // A cell in the corner of a periodic box has seven images, so it can occur eight times.
    let places = if facts.periodic.is_some() { 8 } else { 1 };
    // If the particles have several sizes, each particle is in two fields.
    let fields_per_particle = u64::from(field_count.min(2));
    let most = places * fields_per_particle * shape.cells_per_particle() as u64;
    if full_cells > most.saturating_mul(facts.census.binned as u64) {
        return Err(malformed(
            footer,
            format!("there are more full cells than particles can fill: {full_cells}"),
        ));
    }
    let pages = MappedPages { window, shape, first, bricks, fields, checksums };
    Ok(Index { facts, indicator, sizes, infos, pages })
}

fn read_header(bytes: &[u8]) -> Result<(u32, BrickSide), ReadFault> {
    let mut cursor = Cursor::new(bytes.into(), 0, Endian::Little);
    if cursor.take("the header", MAGIC.len() as u64)? != MAGIC {
        return Err(malformed(0, "not a packed frame: the first bytes differ"));
    }
    let version = cursor.u32("the version")?;
    if !(FIRST_VERSION..=SIZES_VERSION).contains(&version) {
        let what = format!(
            "version {version} of packed frames is not supported, only {FIRST_VERSION} to \
             {SIZES_VERSION}"
        );
        return Err(ReadFault::Unsupported(what));
    }
    let at = cursor.at();
    match cursor.u32("the brick side")? {
        4 => Ok((version, BrickSide::Four)),
        8 => Ok((version, BrickSide::Eight)),
        16 => Ok((version, BrickSide::Sixteen)),
        other => {
            Err(malformed(at, format!("the edge of a brick is {other} cells, expected 4, 8 or 16")))
        }
    }
}

/// Checks the tail of the file, and returns the position of the footer.
fn read_tail(window: &MapWindow) -> Result<usize, ReadFault> {
    let bytes = &window.bytes;
    let have = bytes.len() as u64;
    let needed = (HEADER + FACTS + TAIL) as u64;
    if have < needed {
        return Err(ReadFault::Truncated { what: "a frame".into(), needed, have });
    }
    let tail = bytes.len() - TAIL;
    let mut cursor = Cursor::new(bytes.view(), tail, Endian::Little);
    let footer = cursor.u64("the footer's position")?;
    let checksum = cursor.u32("the footer's checksum")?;
    if cursor.take("the end mark", END_MAGIC.len() as u64)? != END_MAGIC {
        return Err(malformed(
            tail,
            "the end mark is missing: the frame is truncated, or was never finished",
        ));
    }
    let places = HEADER as u64..=(tail - FACTS) as u64;
    if !places.contains(&footer) {
        return Err(malformed(tail, format!("the footer cannot begin at byte {footer}")));
    }
    let mut hasher = Hasher::new();
    window.hash(0..HEADER, &mut hasher);
    window.hash(footer as usize..tail + 8, &mut hasher);
    if hasher.finalize() != checksum {
        return Err(malformed(footer as usize, "the footer does not match its checksum"));
    }
    Ok(footer as usize)
}

/// Reads the facts about the frame, its indicator, its sizes, and the number of pages.
fn read_facts(
    cursor: &mut Cursor<'_>,
) -> Result<(FrameFacts, Indicator, Option<SizeFacts>, u64), ReadFault> {
    let at = cursor.at();
    let fault = |error: &dyn std::fmt::Display| malformed(at, error.to_string());
    let origin = read_point(cursor)?;
    let grid = Grid::new(origin, cursor.f64("the cell size")?).map_err(|e| fault(&e))?;
    let flags = cursor.u32("the flags")?;
    if flags & !(WALLS | PERIODIC | SIZES) != 0 {
        return Err(fault(&"invalid flags"));
    }
    let indicator = cursor.u32("the indicator")?;
    let (lo, hi) = (read_point(cursor)?, read_point(cursor)?);
    let domain = match flags & WALLS {
        0 => None,
        _ => Some(Domain::new(&grid, lo, hi).map_err(|e| fault(&e))?),
    };
    let mean = cursor.f64("mu0")?;
    let mean = || MeanCount::new(mean).map_err(|e| fault(&e));
    let spacing = match cursor.f64("the spacing")? {
        0.0 => None,
        spacing => Some(positive_length("spacing", spacing).map_err(|e| fault(&e))?),
    };
    let indicator = match indicator {
        0 => Indicator::Symmetry,
        1 => Indicator::Counting(mean()?),
        2 => {
            let spacing_cells = spacing.map(|spacing| spacing / grid.cell_size());
            check_finest(spacing_cells, grid.cell_size()).map_err(|e| fault(&e))?;
            Indicator::Cloud
        }
        other => return Err(fault(&format!("the indicator is {other}, expected 0, 1 or 2"))),
    };
    let mut particles = || {
        let count = cursor.u64("a number of particles")?;
        usize::try_from(count).map_err(|_| fault(&format!("{count} particles are too many")))
    };
    let mut census = Census {
        binned: particles()?,
        not_finite: particles()?,
        too_far: particles()?,
        outside: particles()?,
        wrapped: 0,
    };
    let periodic = match flags & PERIODIC {
        0 => None,
        _ => Some(read_periodic(cursor, &grid, &mut census)?),
    };
    let facts = FrameFacts { grid, domain, periodic, census, spacing };
    let sizes = match flags & SIZES {
        0 => None,
        _ if indicator != Indicator::Cloud => {
            let what =
                "particles of several sizes need the indicator cloud, but the file has another one";
            return Err(fault(&what));
        }
        _ => Some(read_sizes(cursor, &facts)?),
    };
    let count = cursor.u64("the number of pages")?;
    Ok((facts, indicator, sizes, count))
}

/// Reads the facts about particles of several sizes.
fn read_sizes(cursor: &mut Cursor<'_>, facts: &FrameFacts) -> Result<SizeFacts, ReadFault> {
    let at = cursor.at();
    let (coarsest, density) = (cursor.f64("the largest size")?, cursor.f64("the density")?);
    let octaves = SampledOctaves::octaves(facts, coarsest).map(|octaves| octaves.count as u32);
    let are_lengths = |&octaves: &u32| {
        let FrameFacts { grid, spacing, .. } = facts.in_octave(octaves - 1);
        let widest = [Some(coarsest), spacing, Some(grid.cell_size())];
        widest.into_iter().flatten().all(|length| length.is_finite() && length > 0.0)
    };
    let octaves = octaves.filter(are_lengths);
    let octaves = octaves.ok_or_else(|| malformed(at, "the sizes of the particles are invalid"))?;
    let density = Some(density).filter(|&density| density != 0.0);
    if density.is_some_and(|density| !DENSITIES.contains(&density)) {
        return Err(malformed(at, "the density of the particles is invalid"));
    }
    Ok(SizeFacts { octaves, coarsest, density })
}

/// Reads the periodic box, and the number of wrapped particles into `census`. An open axis extends
/// from -inf to inf.
fn read_periodic(
    cursor: &mut Cursor<'_>,
    grid: &Grid,
    census: &mut Census,
) -> Result<Periodic, ReadFault> {
    let at = cursor.at();
    let (lo, hi) = (read_point(cursor)?, read_point(cursor)?);
    let reach = cursor.u32("the reach of images")?;
    census.wrapped = cursor.u32("the number of wrapped particles")? as usize;
    let is_open = |a: usize| lo[a] == f64::NEG_INFINITY && hi[a] == f64::INFINITY;
    let faces = [0, 1, 2].map(|axis| (!is_open(axis)).then(|| [lo[axis], hi[axis]]));
    match i32::try_from(reach) {
        Ok(reach @ 0..CELL_LIMIT) if census.wrapped <= census.binned => {
            Periodic::new(grid, faces, reach).map_err(|e| malformed(at, e.to_string()))
        }
        _ => Err(malformed(at, "the periodic box is invalid")),
    }
}

fn read_point(cursor: &mut Cursor<'_>) -> Result<DVec3, ReadFault> {
    let mut x = || cursor.f64("a corner");
    Ok(DVec3::new(x()?, x()?, x()?))
}

/// The entry of a page in the index.
struct PageEntry {
    info: PageInfo,
    /// The number of the page's field.
    field: u16,
    offset: u64,
    length: u64,
    checksum: u32,
}

/// Reads the entry of a page, and checks it without regard to other pages.
fn read_entry(
    cursor: &mut Cursor<'_>,
    side: BrickSide,
    facts: &FrameFacts,
    fields: u32,
) -> Result<PageEntry, ReadFault> {
    let at = cursor.at();
    let key = MortonKey(cursor.u64("a page's key")?);
    let offset = cursor.u64("a page's position")?;
    let bricks = cursor.u64("a page's bricks")?;
    let length = u64::from(cursor.u32("a page's size")?);
    let checksum = cursor.u32("a page's checksum")?;
    let full_count = cursor.u32("a page's full cells")?;
    let mut corner = || {
        let cells = cursor.take("a page's box", 3)?;
        Ok::<_, ReadFault>(IVec3::new(cells[0].into(), cells[1].into(), cells[2].into()))
    };
    let local = CellBox { lo: corner()?, hi: corner()? };
    let field = cursor.u16("a page's field")?;
    if u32::from(field) >= fields {
        let what = format!("a page refers to field {field}, but the last field is {}", fields - 1);
        return Err(malformed(at, what));
    }

    let coord = key.coord();
    let full = CellBox { lo: local.lo + coord * BIN, hi: local.hi + coord * BIN };
    let octave = u32::from(field / 2);
    let grid = CellBox { lo: IVec3::splat(-CELL_LIMIT), hi: IVec3::splat(CELL_LIMIT) };
    // A cloud reaches the cells next to its particle's cell.
    let further = i32::from(octave > 0);
    let limits = grid.in_wider_cells(octave).grown(further, further);
    let walls = facts.domain.map(|domain| domain.in_wider_cells(octave).cells());
    let limits = walls.map_or(limits, |walls| walls.intersection(&limits));
    let beyond = bricks.checked_shr(side.bricks_per_bin() as u32).unwrap_or(0);
    let info = PageInfo { key, bricks, full, full_count };
    let wrong = [
        (MortonKey::of(coord) != key, "the Morton key of a page is invalid"),
        (bricks == 0 || beyond != 0, "a page has no bricks, or bricks outside of its bin"),
        (local.is_empty() || local.hi.max_element() > BIN, "a page's box is not in its bin"),
        (!limits.covers(&full), "a page's box is beyond the grid or the walls"),
        (
            full_count == 0 || full_count as usize > full.volume(),
            "a page's full cells do not fit in its box",
        ),
    ];
    match wrong.into_iter().find(|&(wrong, _)| wrong) {
        Some((_, what)) => Err(malformed(at, what)),
        None => Ok(PageEntry { info, field, offset, length, checksum }),
    }
}
