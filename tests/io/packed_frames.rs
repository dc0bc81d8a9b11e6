//! Tests of packed frames: the field from the file equals the field in memory, and damage is
//! detected.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use glam::{DVec3, IVec3};
use meniscus::files::Replace;
use meniscus::internals::brick::{
    BinPlan, BrickSide, CountingRoom, DifField, FrameFacts, InvalidParticles,
};
use meniscus::internals::field::indicator::{
    CloudWalls, Indicator, IndicatorKind, PageRule, SampledDif, indicate,
};
use meniscus::internals::grid::units::MeanCount;
use meniscus::internals::grid::{CellBox, Domain, Grid, MortonKey, Periodic};
use meniscus::internals::io::ReadFault;
use meniscus::internals::io::bytes::Unpacking;
use meniscus::internals::io::input::open_particles;
use meniscus::internals::io::mnf::{
    FrameWriter, PackableFrame, PackedFrame, frame_from_file, open_frame, write_frame,
};
use meniscus::internals::particles::Particles;
use meniscus::{Cloud, Error, Reconstruction, Surface};
use rayon::prelude::*;
use tempfile::TempDir;

use crate::common::{INDICATORS, full_cells, sampling, splashes, tank};

const SIDES: [BrickSide; 3] = [BrickSide::Four, BrickSide::Eight, BrickSide::Sixteen];

/// Samples particles, and returns the frame.
fn sample(
    particles: &(impl Particles + ?Sized),
    grid: Grid,
    domain: Option<Domain>,
    indicator: IndicatorKind,
    side: BrickSide,
) -> SampledDif {
    let plan = BinPlan::count(
        &particles,
        &grid,
        domain.as_ref(),
        InvalidParticles::Skip,
        CountingRoom::BINS,
    )
    .unwrap();
    let census = plan.census();
    let bins = plan.fill(&particles, &[]).unwrap();
    let facts = FrameFacts { grid, domain, periodic: None, census, spacing: Some(0.5) };
    let spacing_cells = facts.spacing_cells_or_one();
    let rule = PageRule { indicator, spacing_cells, side, walls: CloudWalls::of(&facts) };
    let pages = indicate(&bins, 0..bins.keys().len(), &rule).unwrap();
    let mean = census.binned as f64 / full_cells(&bins) as f64;
    let indicator = indicator.with_mean(|| MeanCount::new(mean)).unwrap();
    SampledDif::new(facts, indicator, DifField::in_memory(rule.shape(), pages))
}

fn encoded(frame: &SampledDif) -> Vec<u8> {
    let mut bytes = Vec::new();
    let written = write_frame(&mut bytes, PackableFrame::Dif(frame)).unwrap();
    assert_eq!(written, bytes.len() as u64);
    bytes
}

/// A frame with a few pages and very few particles, in a tank.
fn small() -> SampledDif {
    let mut particles: Vec<[f64; 3]> = splashes(5).into_iter().step_by(25).collect();
    particles.push([f64::NAN; 3]);
    let domain = tank(&sampling().grid);
    sample(&particles[..], sampling().grid, Some(domain), INDICATORS[1], BrickSide::Four)
}

struct Folder(TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn file(&self, bytes: &[u8]) -> PathBuf {
        let path = self.0.path().join("frame.mnf");
        fs::write(&path, bytes).unwrap();
        path
    }
}

/// Opens a frame whose particles have one size.
fn dif(path: &Path, cache_bytes: u64) -> SampledDif {
    match open_frame(path, cache_bytes, None).unwrap() {
        PackedFrame::Dif(sampled) => sampled,
        PackedFrame::Octaves(_) => panic!("expected particles of one size"),
    }
}

/// The error from opening a frame that is damaged, but has correct checksums.
fn refusal(folder: &Folder, bytes: &[u8]) -> String {
    open_frame(&folder.file(bytes), 1 << 20, None)
        .expect_err("damage is not detected")
        .fault
        .to_string()
}

fn assert_same_frame(found: &SampledDif, expected: &SampledDif, what: &str) {
    assert_eq!((found.facts, found.indicator), (expected.facts, expected.indicator), "{what}");
    let (found, expected) = (&found.dif, &expected.dif);
    assert_eq!(found.infos(), expected.infos(), "{what}");
    assert_eq!(found.side(), expected.side(), "{what}");
    assert_eq!(found.mean_of_full(), expected.mean_of_full(), "{what}");
    let all = expected.infos().iter().fold(CellBox::EMPTY, |all, info| all.union(&info.full));
    let blocks: Vec<_> = all.grown(3, 3).cubes(20).collect();
    blocks.par_iter().for_each(|&block| {
        let cells = CellBox::cube(block, 20).grown(5, 2);
        assert!(found.gather(cells) == expected.gather(cells), "{what}: {cells:?}");
    });
}

#[test]
fn a_packed_field_equals_the_field_in_memory_for_any_cache_size() {
    let folder = Folder::new();
    let particles = splashes(1);
    let grid = sampling().grid;
    for side in SIDES {
        for indicator in INDICATORS {
            for domain in [None, Some(tank(&grid))] {
                let frame = sample(&particles[..], grid, domain, indicator, side);
                let path = folder.file(&encoded(&frame));
                for cache_bytes in [0, 64 << 10, u64::MAX] {
                    let what = format!(
                        "{side:?}, {indicator:?}, {domain:?}, a cache of {cache_bytes} bytes"
                    );
                    assert_same_frame(&dif(&path, cache_bytes), &frame, &what);
                    let scratch =
                        frame_from_file(&fs::File::open(&path).unwrap(), cache_bytes).unwrap();
                    assert_same_frame(&scratch, &frame, &what);
                    assert!(
                        encoded(&scratch) == fs::read(&path).unwrap(),
                        "{what}: the rewritten bytes differ"
                    );
                }
            }
        }
    }
}

#[test]
fn a_packed_frame_is_independent_of_threads_and_page_batches() {
    let particles: Vec<[f64; 3]> = splashes(2).iter().map(|p| p.map(|x| 6.0 * x)).collect();
    let frame = sample(&particles[..], sampling().grid, None, INDICATORS[0], BrickSide::Eight);
    let field = &frame.dif;
    assert!(field.infos().len() > 200, "all pages fit in one chunk");
    let expected = encoded(&frame);
    for threads in [1, 2, 5] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        assert!(pool.install(|| encoded(&frame)) == expected, "{threads} threads");
        let mut bytes = Vec::new();
        let mut writer = FrameWriter::create(&mut bytes, field.shape()).unwrap();
        let pages: Vec<_> = field.infos().iter().copied().zip(0..).collect();
        for batch in pages.chunks(37 * threads) {
            pool.install(|| writer.push(batch, |&page| field.stored(page))).unwrap();
        }
        writer.finish(&frame.facts, frame.indicator).unwrap();
        assert!(bytes == expected, "{} pages at a time", 37 * threads);
    }
}

#[test]
fn extreme_frame_facts_are_preserved() {
    let folder = Folder::new();
    let grid = Grid::new(DVec3::new(-1e300, 0.1, -0.0), 1e-300).unwrap();
    let mut frame = small();
    frame.facts = FrameFacts { grid, domain: None, spacing: None, ..frame.facts };
    frame.facts.census.outside = usize::MAX;
    for mean in [f64::MIN_POSITIVE, MeanCount::MAX] {
        frame.indicator = Indicator::Counting(MeanCount::new(mean).unwrap());
        let found = dif(&folder.file(&encoded(&frame)), 0);
        assert_eq!((found.facts, found.indicator), (frame.facts, frame.indicator));
    }
}

/// A frame in a box that is periodic along y and has walls along x and z.
fn small_periodic() -> SampledDif {
    let (open, mut frame) = (f64::INFINITY, small());
    let grid = frame.facts.grid;
    let walls = [DVec3::new(-13.0, -open, -11.0), DVec3::new(12.0, open, 14.0)];
    let domain = Some(Domain::new(&grid, walls[0], walls[1]).unwrap());
    let periodic = Some(Periodic::new(&grid, [None, Some([-15.0, 9.5]), None], 9).unwrap());
    frame.facts = FrameFacts { domain, periodic, ..frame.facts };
    frame.facts.census.wrapped = 3;
    frame
}

#[test]
fn a_periodic_box_is_preserved_and_damage_to_it_is_detected() {
    let folder = Folder::new();
    let frame = small_periodic();
    let good = encoded(&frame);
    let found = dif(&folder.file(&good), 0);
    assert_eq!((found.facts, found.indicator), (frame.facts, frame.indicator));
    assert!(encoded(&found) == good);
    // Unmap the file, because Windows cannot replace a mapped file.
    drop(found);
    let Layout { footer, index } = Layout::of(&good);
    let (layout, faces) = (Layout { footer, index: index + 56 }, footer + 136);
    let cases: [(usize, Vec<u8>, &str); 7] = [
        (faces, 0_f64.to_le_bytes().into(), "invalid periodic box"),
        (faces + 8, 9.5_f64.to_le_bytes().into(), "invalid periodic box"),
        (faces + 8, (-1e9_f64).to_le_bytes().into(), "from the origin"),
        (faces + 32, 2.5_f64.to_le_bytes().into(), "which is twice the reach"),
        (faces + 48, u32::MAX.to_le_bytes().into(), "the periodic box is invalid"),
        (faces + 52, u32::MAX.to_le_bytes().into(), "the periodic box is invalid"),
        (footer + 32, 1_u32.to_le_bytes().into(), "which does not fit"),
    ];
    for (at, patch, expected) in cases {
        let mut bad = good.clone();
        bad[at..at + patch.len()].copy_from_slice(&patch);
        layout.seal(&mut bad);
        let found = refusal(&folder, &bad);
        assert!(found.contains(expected), "{patch:?} at {at}: {found:?} instead of {expected:?}");
    }
    for at in (0..good.len()).filter(|at| (footer..layout.index).contains(at)) {
        let mut bad = good.clone();
        bad[at] ^= 0x80;
        assert!(open_frame(&folder.file(&bad), 0, None).is_err(), "byte {at}");
        assert!(open_frame(&folder.file(&good[..at]), 0, None).is_err(), "a prefix of {at} bytes");
    }
}

#[test]
fn a_packed_frame_without_pages_can_be_read() {
    let folder = Folder::new();
    let SampledDif { facts, indicator, .. } = small();
    let none = DifField::in_memory(BrickSide::Eight.into(), Vec::new());
    let empty = SampledDif::new(facts, indicator, none);
    let found = dif(&folder.file(&encoded(&empty)), 0);
    assert_eq!((found.facts, found.dif.infos().len()), (facts, 0));
    assert_eq!(found.dif.gather(CellBox::cube(IVec3::ZERO, 8)).samples(), [0; 512]);
}

#[test]
fn every_flipped_byte_and_every_truncation_is_a_typed_error() {
    let folder = Folder::new();
    let frame = small();
    let good = encoded(&frame);
    assert!(frame.dif.infos().len() > 5 && good.len() < 20_000, "{} bytes", good.len());
    let kind = |bytes: &[u8], what: &str| {
        let path = folder.file(bytes);
        match open_frame(&path, 1 << 20, None) {
            Ok(_) => panic!("{what} is not detected"),
            Err(error) => {
                assert_eq!(error.path, path);
                error.fault
            }
        }
    };
    for at in 0..good.len() {
        for flip in [1, 0x80, 0xff] {
            let mut bad = good.clone();
            bad[at] ^= flip;
            let fault = kind(&bad, &format!("{flip:#x} at byte {at}"));
            let damage = matches!(fault, ReadFault::Malformed { .. } | ReadFault::Unsupported(_));
            assert!(damage, "byte {at}: {fault}");
        }
        let fault = kind(&good[..at], &format!("a prefix of {at} bytes"));
        let cut = matches!(fault, ReadFault::Truncated { .. } | ReadFault::Malformed { .. });
        assert!(cut || at == 0, "{at} bytes: {fault}");
    }
    let mut longer = good;
    longer.push(0);
    assert!(matches!(kind(&longer, "an extra byte"), ReadFault::Malformed { .. }));
}

/// The offsets of the footer and the index. The module of packed frames documents the format.
struct Layout {
    footer: usize,
    index: usize,
}

impl Layout {
    fn of(bytes: &[u8]) -> Self {
        let tail = bytes.len() - 20;
        let footer = u64::from_le_bytes(bytes[tail..tail + 8].try_into().unwrap()) as usize;
        Self { footer, index: footer + 144 }
    }

    /// Corrects the footer's checksum.
    fn seal(&self, bytes: &mut [u8]) {
        let tail = bytes.len() - 20;
        let mut hasher = crc32fast::Hasher::new();
        hasher.update(&bytes[..16]);
        hasher.update(&bytes[self.footer..tail + 8]);
        bytes[tail + 8..tail + 12].copy_from_slice(&hasher.finalize().to_le_bytes());
    }
}

#[test]
fn invalid_values_with_valid_checksums_are_refused() {
    let folder = Folder::new();
    let good = encoded(&small());
    let layout = Layout::of(&good);
    let Layout { footer, index } = layout;
    let second = index + 44;
    let cases: Vec<(usize, Vec<u8>, &str)> = vec![
        (8, 4_u32.to_le_bytes().into(), "version 4 of packed frames is not supported, only 1 to 3"),
        (8, 3_u32.to_le_bytes().into(), "the flags of another version"),
        (8, 0_u32.to_le_bytes().into(), "version 0 of packed frames"),
        (12, 5_u32.to_le_bytes().into(), "the edge of a brick is 5 cells"),
        (12, 8_u32.to_le_bytes().into(), "bricks outside of its bin"),
        (footer, f64::NAN.to_le_bytes().into(), "origin"),
        (footer + 24, 0_f64.to_le_bytes().into(), "cell-size"),
        (footer + 32, 8_u32.to_le_bytes().into(), "flags"),
        (footer + 32, 4_u32.to_le_bytes().into(), "need the indicator cloud"),
        (footer + 32, 3_u32.to_le_bytes().into(), "periodic box"),
        (footer + 36, 2_u32.to_le_bytes().into(), "does not decompress to its size"),
        (footer + 36, 3_u32.to_le_bytes().into(), "the indicator is 3"),
        (footer + 36, 0_u32.to_le_bytes().into(), ""),
        (footer + 40, 1e9_f64.to_le_bytes().into(), "invalid domain"),
        (footer + 40, 0_f64.to_le_bytes().into(), "beyond the grid or the walls"),
        (footer + 88, 0_f64.to_le_bytes().into(), "mu0"),
        (footer + 96, (-1_f64).to_le_bytes().into(), "spacing"),
        (footer + 104, 1_u64.to_le_bytes().into(), "more full cells than particles"),
        (footer + 136, 1_u64.to_le_bytes().into(), "which does not fit 1 pages"),
        (footer + 136, u64::MAX.to_le_bytes().into(), "which does not fit"),
        (index, (1_u64 << 63).to_le_bytes().into(), "the Morton key of a page is invalid"),
        (index, 0_u64.to_le_bytes().into(), "beyond the grid or the walls"),
        (second, good[index..index + 8].into(), ""),
        (index + 8, 17_u64.to_le_bytes().into(), "where the one before it ends"),
        (index + 16, 0_u64.to_le_bytes().into(), "a page has no bricks"),
        (index + 16, u64::MAX.to_le_bytes().into(), "does not decompress to its size"),
        (index + 24, u32::MAX.to_le_bytes().into(), "where the one before it ends"),
        (index + 24, 0_u32.to_le_bytes().into(), "where the one before it ends"),
        (index + 28, 0_u32.to_le_bytes().into(), "page 0 does not match its checksum"),
        (index + 32, 0_u32.to_le_bytes().into(), "do not fit in its box"),
        (index + 32, 2_u32.to_le_bytes().into(), "page 0 contains other cells"),
        (index + 36, [15, 15, 15, 17, 16, 16].into(), "not in its bin"),
        (index + 36, [3, 3, 3, 3, 4, 4].into(), "not in its bin"),
        (index + 42, [1, 0].into(), "refers to field 1, but the last field is 0"),
    ];
    for (at, patch, expected) in cases {
        let mut bad = good.clone();
        bad[at..at + patch.len()].copy_from_slice(&patch);
        layout.seal(&mut bad);
        if expected.is_empty() {
            // The result may be a frame or an error, but the library must not panic.
            let _ = open_frame(&folder.file(&bad), 0, None);
            continue;
        }
        let found = refusal(&folder, &bad);
        assert!(found.contains(expected), "{patch:?} at {at}: {found:?} instead of {expected:?}");
    }
}

/// A packed frame of a few particles of sizes 1 to 3, in three octaves, the last of which is empty.
fn small_sizes(folder: &Folder) -> Vec<u8> {
    let positions: Vec<[f64; 3]> =
        (0..24_u32).map(|i| [i % 3, i / 3 % 3, i / 9].map(|c| f64::from(c) * 0.9 + 0.3)).collect();
    let sizes: Vec<f32> = (0..24_u8).map(|i| [1.0, 1.0, 2.0, 3.0][usize::from(i % 4)]).collect();
    let cloud = Cloud::new(&positions).with("size", &sizes);
    let request = Reconstruction::new().size("size").cell(0.8);
    let request = request.origin([0.0; 3]).domain([-4.0; 3], [9.0; 3]);
    let path = folder.0.path().join("sizes.mnf");
    let output = request.packed_output(&path, Replace::Allow).unwrap();
    request.sample(&cloud).unwrap().pack(output).unwrap();
    fs::read(path).unwrap()
}

#[test]
fn packed_sizes_keep_their_bytes_and_damage_to_them_is_detected() {
    let folder = Folder::new();
    let good = small_sizes(&folder);
    assert_eq!(good[8..12], 3_u32.to_le_bytes());
    let found = open_frame(&folder.file(&good), 0, None).unwrap();
    let PackedFrame::Octaves(octaves) = &found else { panic!("expected several sizes") };
    assert_eq!((octaves.facts.spacing, octaves.coarsest), (Some(1.0), 3.0));
    assert_eq!((octaves.clouds.octaves(), found.samples().fields().len()), (3, 6));
    assert!(found.samples().fields().iter().filter(|(_, field)| field.bricks() > 0).count() >= 2);
    let mut again = Vec::new();
    write_frame(&mut again, found.samples()).unwrap();
    assert!(again == good, "the rewritten bytes differ");
    // Unmap the file, because Windows cannot replace a mapped file.
    drop(found);
    let Layout { footer, index } = Layout::of(&good);
    let (layout, sizes) = (Layout { footer, index: index + 16 }, footer + 136);
    let index = layout.index;
    let cases: Vec<(usize, Vec<u8>, &str)> = vec![
        (8, 2_u32.to_le_bytes().into(), "the flags of another version"),
        (footer + 36, 0_u32.to_le_bytes().into(), "need the indicator cloud"),
        (footer + 96, 0_f64.to_le_bytes().into(), "the sizes of the particles are invalid"),
        (sizes, 0_f64.to_le_bytes().into(), "the sizes of the particles are invalid"),
        (sizes, f64::NAN.to_le_bytes().into(), "the sizes of the particles are invalid"),
        (sizes, 1e308_f64.to_le_bytes().into(), ""),
        (footer + 24, 1e308_f64.to_le_bytes().into(), "no cell centre"),
        (sizes, 1_f64.to_le_bytes().into(), "but the last field is 1"),
        (sizes + 8, (-1_f64).to_le_bytes().into(), "the density of the particles is invalid"),
        (sizes + 8, 1e-9_f64.to_le_bytes().into(), "the density of the particles is invalid"),
        (sizes + 8, 1e9_f64.to_le_bytes().into(), "the density of the particles is invalid"),
        (sizes + 8, f64::NAN.to_le_bytes().into(), "the density of the particles is invalid"),
        (index + 42, 6_u16.to_le_bytes().into(), "refers to field 6, but the last field is 5"),
        (index + 42, 3_u16.to_le_bytes().into(), "not in order"),
    ];
    for (at, patch, expected) in cases {
        let mut bad = good.clone();
        bad[at..at + patch.len()].copy_from_slice(&patch);
        layout.seal(&mut bad);
        if expected.is_empty() {
            // The result may be a frame or an error, but the library must not panic.
            let _ = Reconstruction::new().run_file(folder.file(&bad));
            continue;
        }
        let found = refusal(&folder, &bad);
        assert!(found.contains(expected), "{patch:?} at {at}: {found:?} instead of {expected:?}");
    }
    for at in 0..good.len() {
        let mut bad = good.clone();
        bad[at] ^= 0x80;
        assert!(open_frame(&folder.file(&bad), 0, None).is_err(), "byte {at}");
        assert!(open_frame(&folder.file(&good[..at]), 0, None).is_err(), "a prefix of {at} bytes");
    }
}

#[test]
fn packed_sizes_in_large_cells_and_far_away_are_read() {
    let folder = Folder::new();
    let path = folder.0.path().join("far.mnf");
    let sizes: Vec<f32> = [vec![1.0; 30], vec![40.0; 30]].concat();
    let positions: Vec<[f64; 3]> = (0..60).map(|i| [f64::from(i) * 9.0, 0.0, 0.0]).collect();
    // In cells of 20 particle sizes, the nominal plateau exceeds the range of samples.
    for cell in [0.5, 20.0] {
        let cloud = Cloud::new(&positions).with("size", &sizes);
        let request = Reconstruction::new().size("size").cell(cell);
        let output = request.packed_output(&path, Replace::Allow).unwrap();
        let frame = request.sample(&cloud).unwrap();
        frame.pack(output).unwrap();
        let of = |surface: Surface| surface.to_mesh().unwrap().triangles.len();
        let expected = frame.surface().map(of).map_err(|error| error.to_string());
        let found = Reconstruction::new().run_file(&path).map(of);
        let of_file =
            |error: Error| error.to_string().replace(&format!("{}: ", path.display()), "");
        assert_eq!(found.map_err(of_file), expected, "cells of {cell}");
    }
    // Move a page of the coarsest octave beyond the finest grid.
    let good = fs::read(&path).unwrap();
    let Layout { footer, index } = Layout::of(&good);
    let (layout, mut bad) = (Layout { footer, index: index + 16 }, good);
    let last = bad.len() - 20 - 44;
    let far = MortonKey::of(IVec3::new(200_000, 0, 0));
    bad[last..last + 8].copy_from_slice(&far.0.to_le_bytes());
    layout.seal(&mut bad);
    assert!(refusal(&folder, &bad).contains("beyond the grid"));
}

#[test]
fn packed_frames_of_version_1_are_read_unless_they_contain_clouds() {
    let folder = Folder::new();
    let particles = splashes(5);
    for indicator in INDICATORS {
        let frame = sample(&particles[..], sampling().grid, None, indicator, BrickSide::Eight);
        let mut bytes = encoded(&frame);
        assert_eq!(bytes[8..12], 2_u32.to_le_bytes());
        bytes[8] = 1;
        assert!(refusal(&folder, &bytes).contains("checksum"), "{indicator:?}");
        Layout::of(&bytes).seal(&mut bytes);
        if indicator == IndicatorKind::Cloud {
            let found = open_frame(&folder.file(&bytes), 1 << 20, None).unwrap_err().fault;
            assert!(matches!(found, ReadFault::Unsupported(_)), "{found}");
            assert!(found.to_string().contains("version 1 of the indicator cloud"), "{found}");
            assert!(found.to_string().contains("pack the particles again"), "{found}");
        } else {
            assert_same_frame(&dif(&folder.file(&bytes), 1 << 20), &frame, "version 1");
        }
    }
}

#[test]
fn packed_clouds_keep_their_spacing() {
    let folder = Folder::new();
    for spacing in [None, Some(0.05), Some(0.5), Some(1.5), Some(7.0)] {
        let mut frame = sample(
            &splashes(5)[..],
            sampling().grid,
            None,
            IndicatorKind::Cloud,
            BrickSide::Sixteen,
        );
        frame.facts.spacing = spacing;
        let found = dif(&folder.file(&encoded(&frame)), 1 << 20);
        assert_eq!((found.indicator, found.facts), (Indicator::Cloud, frame.facts));
    }
}

#[test]
fn impossible_samples_in_the_ghost_layer_of_a_page_are_refused() {
    let folder = Folder::new();
    let particle = [[8.5; 3]];
    let cloud = IndicatorKind::Cloud;
    let frame = sample(&particle[..], sampling().grid, None, cloud, BrickSide::Sixteen);
    let field = &frame.dif;
    let mut samples = field.stored(0).to_vec();
    let written = |samples: &[u16]| {
        let mut bytes = Vec::new();
        let mut writer = FrameWriter::create(&mut bytes, field.shape()).unwrap();
        writer.push(&[(field.infos()[0], samples)], |&samples| samples.into()).unwrap();
        writer.finish(&frame.facts, frame.indicator).unwrap();
        bytes
    };
    let mut whole = written(&samples);
    open_frame(&folder.file(&whole), 0, None).unwrap();
    samples[0] = 1;
    assert!(refusal(&folder, &written(&samples)).contains("page 0 contains other cells"));

    // Set the footer's number of particles to the largest possible value.
    let layout = Layout::of(&whole);
    whole[layout.footer + 104..][..8].fill(0xff);
    layout.seal(&mut whole);
    open_frame(&folder.file(&whole), 0, None).unwrap();
}

#[test]
fn unfinished_packed_frames_and_other_files_are_refused() {
    let folder = Folder::new();
    let whole = encoded(&small());
    let unfinished = &whole[..Layout::of(&whole).footer];
    let fault = open_frame(&folder.file(unfinished), 0, None).unwrap_err().fault;
    assert!(matches!(fault, ReadFault::Malformed { .. }), "{fault}");
    assert!(refusal(&folder, b"ply\nformat ascii 1.0\n").contains("not a packed frame"));
    let missing = open_frame(Path::new("/nowhere/frame.mnf"), 0, None).unwrap_err();
    assert!(matches!(missing.fault, ReadFault::Io(_)), "{missing}");
}

/// A writer that fails after this number of bytes.
struct FullDisk(usize);

impl Write for FullDisk {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let taken = bytes.len().min(self.0);
        self.0 -= taken;
        if taken == 0 { Err(std::io::ErrorKind::StorageFull.into()) } else { Ok(taken) }
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

#[test]
fn a_full_disk_at_any_byte_is_an_error() {
    let frame = small();
    let whole = encoded(&frame).len();
    for room in (0..whole).step_by(7) {
        let fault = write_frame(FullDisk(room), PackableFrame::Dif(&frame)).unwrap_err();
        assert_eq!(fault.kind(), std::io::ErrorKind::StorageFull);
    }
    write_frame(FullDisk(whole), PackableFrame::Dif(&frame)).unwrap();
}

#[test]
fn pages_of_real_frames_compress_well() {
    let data = crate::common::files::data("");
    for (name, spacing) in [
        ("dambreak_small/ParticleData_Fluid_1.bgeo", 0.05),
        ("dambreak_small/ParticleData_Fluid_20.bgeo", 0.05),
        ("dualsphysics_dambreak/Part_0005.bi4", 0.02),
    ] {
        let unpacking = Unpacking { in_memory: 1 << 30, scratch: &data, control: None };
        let particles = open_particles(&data.join(name), unpacking).unwrap().particles;
        for indicator in INDICATORS {
            let grid = Grid::new(DVec3::ZERO, spacing).unwrap();
            let frame = sample(&particles, grid, None, indicator, BrickSide::Eight);
            let (field, bytes) = (&frame.dif, encoded(&frame).len() as f64);
            let ratio = field.sample_bytes() as f64 / bytes;
            println!(
                "{name}, {indicator:?}: {} pages, {ratio:.2} times smaller",
                field.infos().len()
            );
            let least = if matches!(indicator, IndicatorKind::Counting) { 5.0 } else { 1.5 };
            assert!(ratio > least, "{name}, {indicator:?}: {ratio}");
        }
    }
}
