use std::borrow::Cow;
use std::io::{self, Write};

use crc32fast::Hasher;
use rayon::prelude::*;
use zstd::bulk::Compressor;
use zstd::zstd_safe::CParameter;

use crate::brick::{DifField, FrameFacts, PageInfo, PageShape};
use crate::field::indicator::Indicator;
use crate::grid::BIN;
use crate::grid::units::MeanCount;

use super::{
    END_MAGIC, HEADER, MAGIC, PERIODIC, PackableFrame, SIZES, SIZES_VERSION, TAIL, VERSION, WALLS,
    planes_from_samples,
};

/// Compression level of zstd. Writing must be fast, and higher levels do not compress the noise in
/// samples better.
const LEVEL: i32 = 1;
/// Number of pages that a thread compresses with one context.
const CHUNK: usize = 64;

/// Writes a frame page by page. Keeps the index and one batch of compressed pages in memory.
///
/// Until [`finish`](Self::finish) is called, the file is incomplete, and all readers reject it.
#[derive(Debug)]
pub struct FrameWriter<W> {
    out: W,
    shape: PageShape,
    header: [u8; HEADER],
    /// Byte offset at which the next page will be written.
    at: u64,
    pages: u64,
    index: Vec<u8>,
    /// The number of the field whose pages are being written.
    field: u16,
    last: Option<PageInfo>,
}

/// Compressed pages that are adjacent in the file.
struct CompressedPages {
    bytes: Vec<u8>,
    /// Length, in bytes, and checksum of each page.
    parts: Vec<(usize, u32)>,
}

impl<W: Write> FrameWriter<W> {
    /// Writes the header of a frame whose pages have `shape`. All later writes are large, so `out`
    /// needs no buffer.
    ///
    /// # Errors
    /// The errors of `out`. The methods below also return them.
    pub fn create(out: W, shape: PageShape) -> io::Result<Self> {
        Self::of_version(VERSION, out, shape)
    }

    fn of_version(version: u32, mut out: W, shape: PageShape) -> io::Result<Self> {
        let mut header = [0; HEADER];
        header[..8].copy_from_slice(&MAGIC);
        header[8..12].copy_from_slice(&version.to_le_bytes());
        header[12..].copy_from_slice(&shape.side.cells().to_le_bytes());
        out.write_all(&header)?;
        Ok(Self {
            out,
            shape,
            header,
            at: HEADER as u64,
            pages: 0,
            index: Vec::new(),
            field: 0,
            last: None,
        })
    }

    /// Appends all pages of a field. At most one batch of pages is in memory.
    fn push_field(&mut self, field: &DifField) -> io::Result<()> {
        // Two chunks per thread form a batch, to reduce the wait for the last chunk.
        let batch = 2 * CHUNK * rayon::current_num_threads();
        for first in (0..field.infos().len()).step_by(batch) {
            let infos = field.infos()[first..].iter().take(batch);
            let pages: Vec<_> = infos.copied().zip(first..).collect();
            self.push(&pages, |&page| field.stored(page))?;
        }
        Ok(())
    }

    /// Appends pages. `samples` returns the samples of all bricks of a page.
    ///
    /// Pages are compressed on all threads and written in order. The bytes depend neither on the
    /// number of threads nor on how the pages are divided among calls.
    ///
    /// # Panics
    /// If pages are not in key order, or if the number of a page's samples does not match its
    /// bricks.
    pub fn push<'a, P: Sync>(
        &mut self,
        pages: &'a [(PageInfo, P)],
        samples: impl Fn(&'a P) -> Cow<'a, [u16]> + Sync,
    ) -> io::Result<()> {
        for (info, _) in pages {
            assert!(self.last.is_none_or(|last| last.key < info.key), "pages are in order");
            self.last = Some(*info);
        }
        let shape = self.shape;
        let compressed: Vec<io::Result<CompressedPages>> =
            pages.par_chunks(CHUNK).map(|pages| compress(pages, &samples, shape)).collect();
        for (pages, compressed) in pages.chunks(CHUNK).zip(compressed) {
            let CompressedPages { bytes, parts } = compressed?;
            self.out.write_all(&bytes)?;
            for ((info, _), (length, checksum)) in pages.iter().zip(parts) {
                self.push_index_entry(info, length, checksum);
            }
        }
        Ok(())
    }

    /// Adds the entry of a page to the index.
    fn push_index_entry(&mut self, info: &PageInfo, length: usize, checksum: u32) {
        let corner = info.key.coord() * BIN;
        let index = &mut self.index;
        index.extend(info.key.0.to_le_bytes());
        index.extend(self.at.to_le_bytes());
        index.extend(info.bricks.to_le_bytes());
        index.extend((length as u32).to_le_bytes());
        index.extend(checksum.to_le_bytes());
        index.extend(info.full_count.to_le_bytes());
        for end in [info.full.lo, info.full.hi] {
            index.extend((end - corner).to_array().map(|cells| cells as u8));
        }
        index.extend(self.field.to_le_bytes());
        self.at += length as u64;
        self.pages += 1;
    }

    /// Writes the footer, the index and the tail. Returns the size of the file in bytes.
    pub fn finish(self, facts: &FrameFacts, indicator: Indicator) -> io::Result<u64> {
        self.finish_with(footer(facts, indicator, 0))
    }

    /// Writes the footer, the index and the tail. `footer` lacks only the number of pages, which
    /// this function appends.
    fn finish_with(mut self, mut footer: Vec<u8>) -> io::Result<u64> {
        footer.extend(self.pages.to_le_bytes());
        let footer_at = self.at.to_le_bytes();
        let mut hasher = Hasher::new();
        [&self.header[..], &footer, &self.index, &footer_at]
            .into_iter()
            .for_each(|part| hasher.update(part));
        self.out.write_all(&footer)?;
        self.out.write_all(&self.index)?;
        self.out
            .write_all(&[&footer_at[..], &hasher.finalize().to_le_bytes(), &END_MAGIC].concat())?;
        self.out.flush()?;
        Ok(self.at + (footer.len() + self.index.len() + TAIL) as u64)
    }
}

/// The footer up to and including the periodic box, without the facts about several sizes and
/// without the number of pages. `more_flags` are additional flags.
fn footer(facts: &FrameFacts, indicator: Indicator, more_flags: u32) -> Vec<u8> {
    let walls = facts.domain.map_or([0.0; 6], |domain| {
        let [lo, hi] = domain.walls().map(|corner| corner.to_array());
        [lo[0], lo[1], lo[2], hi[0], hi[1], hi[2]]
    });
    let mean = indicator.mean().map_or(0.0, MeanCount::particles);
    let indicator = match indicator {
        Indicator::Symmetry => 0_u32,
        Indicator::Counting(_) => 1,
        Indicator::Cloud => 2,
    };
    let census = &facts.census;
    let particles = [census.binned, census.not_finite, census.too_far, census.outside];
    let mut footer = Vec::new();
    footer.extend(facts.grid.origin().to_array().iter().flat_map(|x| x.to_le_bytes()));
    footer.extend(facts.grid.cell_size().to_le_bytes());
    let walled = if facts.domain.is_some() { WALLS } else { 0 };
    let repeated = if facts.periodic.is_some() { PERIODIC } else { 0 };
    footer.extend((walled | repeated | more_flags).to_le_bytes());
    footer.extend(indicator.to_le_bytes());
    footer.extend(walls.iter().flat_map(|x| x.to_le_bytes()));
    footer.extend(mean.to_le_bytes());
    footer.extend(facts.spacing.unwrap_or(0.0).to_le_bytes());
    footer.extend(particles.iter().flat_map(|&count| (count as u64).to_le_bytes()));
    if let Some(periodic) = &facts.periodic {
        let open = [f64::NEG_INFINITY, f64::INFINITY];
        let faces = periodic.faces().map(|faces| faces.unwrap_or(open));
        let corners = [0, 1].map(|side: usize| faces.map(|faces| faces[side]));
        footer.extend(corners.as_flattened().iter().flat_map(|x| x.to_le_bytes()));
        footer.extend(periodic.reach().to_le_bytes());
        footer.extend(u32::try_from(census.wrapped).unwrap_or(u32::MAX).to_le_bytes());
    }
    footer
}

fn compress<'a, P>(
    pages: &'a [(PageInfo, P)],
    samples: impl Fn(&'a P) -> Cow<'a, [u16]>,
    shape: PageShape,
) -> io::Result<CompressedPages> {
    let mut compressor = Compressor::new(LEVEL)?;
    // The index implies the unpacked size of each page, so the page does not store it.
    compressor.set_parameter(CParameter::ContentSizeFlag(false))?;
    let mut compressed =
        CompressedPages { bytes: Vec::new(), parts: Vec::with_capacity(pages.len()) };
    for (info, page) in pages {
        let samples = samples(page);
        assert_eq!(samples.len(), info.samples(shape), "samples of {info:?}");
        let page = compressor.compress(&planes_from_samples(&samples))?;
        compressed.parts.push((page.len(), crc32fast::hash(&page)));
        compressed.bytes.extend(page);
    }
    Ok(compressed)
}

/// Writes a complete frame, which may be larger than memory. Returns the size of the file in bytes.
pub fn write_frame(out: impl Write, frame: PackableFrame<'_>) -> io::Result<u64> {
    let (facts, indicator) = (frame.facts(), frame.indicator());
    let (version, flags) = match frame {
        PackableFrame::Dif(_) => (VERSION, 0),
        PackableFrame::Octaves(_) => (SIZES_VERSION, SIZES),
    };
    let fields = frame.fields();
    let mut writer = FrameWriter::of_version(version, out, fields[0].1.shape())?;
    for (number, (_, field)) in (0..).zip(fields) {
        (writer.field, writer.last) = (number, None);
        writer.push_field(field)?;
    }
    let mut footer = footer(facts, indicator, flags);
    if let PackableFrame::Octaves(sampled) = frame {
        footer.extend(sampled.coarsest.to_le_bytes());
        footer.extend(sampled.density.unwrap_or(0.0).to_le_bytes());
    }
    writer.finish_with(footer)
}
