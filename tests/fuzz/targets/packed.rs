//! Fuzzes packed frames: their bytes with corrected checksums, frames that are built from mutated
//! pages, and their surfaces.

use meniscus::files::Replace;
use meniscus::internals::grid::CellBox;
use meniscus::internals::io::mnf::open_frame;
use meniscus::mesh::check;
use meniscus::{Cloud, IndicatorKind, Reconstruction};

use super::{Target, folder};

pub fn targets() -> Vec<Target> {
    vec![
        Target {
            name: "mnf",
            runs: 2000,
            run: |data| open(&sealed(data)),
            seeds: of_one_size,
            words: &[],
        },
        Target {
            name: "mnf-sizes",
            runs: 2000,
            run: |data| open(&sealed(data)),
            seeds: of_several_sizes,
            words: &[],
        },
        Target {
            name: "mnf-pages",
            runs: 2000,
            run: |data| open(&built(data)),
            seeds: plain,
            words: &[],
        },
        Target {
            name: "mnf-surface",
            runs: 100,
            run: |data| check_surface(&built(data)),
            seeds: plain,
            words: &[],
        },
    ]
}

const HEADER: usize = 16;
/// The size, in bytes, of the footer without the number of pages, the periodic box and the sizes.
const FACTS: usize = 136;
const PERIODIC: usize = 56;
const SIZES: usize = 16;
const ENTRY: usize = 44;
const TAIL: usize = 20;
const MAGIC: &[u8] = b"\x89MNF\r\n\x1a\n";
const END_MAGIC: &[u8] = b"\n\x1a\n\rFNM\x89";

fn u64_at(bytes: &[u8], at: usize) -> Option<u64> {
    Some(u64::from_le_bytes(bytes.get(at..at + 8)?.try_into().unwrap()))
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().unwrap()))
}

/// The offsets of a frame's footer and of its index.
fn layout(bytes: &[u8]) -> Option<(usize, usize)> {
    let tail = bytes.len().checked_sub(TAIL)?;
    let footer = usize::try_from(u64_at(bytes, tail)?)
        .ok()
        .filter(|footer| (HEADER..tail).contains(footer))?;
    let index = footer + FACTS + optional_size(u32_at(bytes, footer + 32)?) + 8;
    (index <= tail).then_some((footer, index))
}

/// The size, in bytes, of the parts of the footer that depend on its flags.
fn optional_size(flags: u32) -> usize {
    [(2, PERIODIC), (4, SIZES)]
        .iter()
        .filter(|(flag, _)| flags & flag != 0)
        .map(|(_, size)| size)
        .sum()
}

/// Corrects all checksums of a frame that lie within the bytes.
fn sealed(data: &[u8]) -> Vec<u8> {
    let mut bytes = data.to_vec();
    let Some((footer, index)) = layout(&bytes) else { return bytes };
    let tail = bytes.len() - TAIL;
    for entry in (index..tail).step_by(ENTRY).take_while(|entry| entry + ENTRY <= tail) {
        let at = u64_at(&bytes, entry + 8).and_then(|at| usize::try_from(at).ok());
        let length = u32_at(&bytes, entry + 24).map(|length| length as usize);
        let page = at.zip(length).and_then(|(at, length)| bytes.get(at..at.checked_add(length)?));
        if let Some(sum) = page.map(crc32fast::hash) {
            bytes[entry + 28..entry + 32].copy_from_slice(&sum.to_le_bytes());
        }
    }
    seal_footer(&mut bytes, footer);
    bytes
}

fn seal_footer(bytes: &mut [u8], footer: usize) {
    let tail = bytes.len() - TAIL;
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(&bytes[..HEADER]);
    hasher.update(&bytes[footer..tail + 8]);
    bytes[tail + 8..tail + 12].copy_from_slice(&hasher.finalize().to_le_bytes());
}

/// Builds a frame from uncompressed bytes: the version, the brick side and the footer, and for each
/// page its key, bricks, full cells, box and field, and the length and the bytes of its planes.
fn built(plain: &[u8]) -> Vec<u8> {
    let mut rest = plain;
    let mut take = |count: usize| {
        let (taken, left) = rest.split_at(count.min(rest.len()));
        rest = left;
        let mut taken = taken.to_vec();
        taken.resize(count, 0);
        taken
    };
    let [version, side] = [take(1)[0], take(1)[0]];
    let mut footer = take(FACTS);
    let flags = u32_at(&footer, 32).unwrap_or_default();
    footer.extend(take(optional_size(flags)));
    let mut bytes = MAGIC.to_vec();
    bytes.extend(u32::from(version).to_le_bytes());
    bytes.extend(u32::from(side).to_le_bytes());
    let (mut index, mut pages) = (Vec::new(), 0_u64);
    let mut compressor = zstd::bulk::Compressor::new(1).unwrap();
    compressor.set_parameter(zstd::zstd_safe::CParameter::ContentSizeFlag(false)).unwrap();
    loop {
        let head = take(28);
        let length = u16::from_le_bytes(take(2).try_into().unwrap());
        if head.iter().all(|&byte| byte == 0) && length == 0 {
            break;
        }
        let page = compressor.compress(&take(length.into())).unwrap();
        index.extend(&head[..8]);
        index.extend((bytes.len() as u64).to_le_bytes());
        index.extend(&head[8..16]);
        index.extend((page.len() as u32).to_le_bytes());
        index.extend(crc32fast::hash(&page).to_le_bytes());
        index.extend(&head[16..28]);
        bytes.extend(page);
        pages += 1;
    }
    let at = bytes.len();
    bytes.extend(footer);
    bytes.extend(pages.to_le_bytes());
    bytes.extend(index);
    bytes.extend((at as u64).to_le_bytes());
    bytes.extend([0; 4]);
    bytes.extend(END_MAGIC);
    seal_footer(&mut bytes, at);
    bytes
}

/// The inverse of [`built`], for an undamaged frame.
fn unbuilt(frame: &[u8]) -> Vec<u8> {
    let (footer, index) = layout(frame).unwrap();
    let mut plain = vec![frame[8], frame[12]];
    plain.extend(&frame[footer..index - 8]);
    for entry in frame[index..frame.len() - TAIL].chunks(ENTRY) {
        let (at, length) =
            (u64_at(entry, 8).unwrap() as usize, u32_at(entry, 24).unwrap() as usize);
        let planes = zstd::bulk::decompress(&frame[at..at + length], 1 << 16).unwrap();
        plain.extend([&entry[..8], &entry[16..24], &entry[32..44]].concat());
        plain.extend((planes.len() as u16).to_le_bytes());
        plain.extend(planes);
    }
    assert!(built(&plain) == frame, "the rebuilt frame has other bytes");
    plain
}

/// Opens a frame, and reads its field.
fn open(bytes: &[u8]) {
    let path = folder::file("a.mnf", bytes);
    for cache in [0, u64::MAX] {
        let Ok(frame) = open_frame(&path, cache, None) else { return };
        for (_, field) in frame.samples().fields() {
            for info in field.infos().iter().take(3) {
                let _ = field.gather(info.full.grown(3, 3));
                let _ = field.gather(CellBox::cube(info.key.coord(), 16));
            }
        }
    }
}

/// Computes the surface of a frame. The surface must be closed, oriented and manifold, unless there
/// is an error.
fn check_surface(bytes: &[u8]) {
    let path = folder::file("b.mnf", bytes);
    let request = Reconstruction::new().threads(1).scratch(std::env::temp_dir());
    let surface = request.run_file(&path);
    match surface {
        Ok(surface) => {
            let report = check(&surface.to_mesh().unwrap());
            assert!(
                report.is_closed_oriented_manifold() || surface.mesh().triangle_count() == 0,
                "{report}"
            );
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}

/// Packs a frame of `count` particles with the settings of `request`.
fn packed(request: Reconstruction, count: u32, sizes: Option<&[f32]>) -> Vec<u8> {
    let place = |i: u32| [i % 3, i / 3 % 3, i / 9].map(|c| f64::from(c) * 0.9 + 0.3);
    let particles: Vec<[f64; 3]> = (0..count).map(place).collect();
    let request = request.cell(1.0).threads(1);
    let frame = match sizes {
        Some(sizes) => request.size("size").sample(&Cloud::new(&particles).with("size", sizes)),
        None => request.spacing(1.0).sample(&particles),
    };
    let path = folder::path("seed.mnf");
    frame
        .unwrap()
        .pack(Reconstruction::new().packed_output(&path, Replace::Allow).unwrap())
        .unwrap();
    std::fs::read(&path).unwrap()
}

/// Small seed frames of particles of one size: with every indicator, with walls, with a periodic
/// box, and in the first version of the format.
fn of_one_size() -> Vec<Vec<u8>> {
    let by = |kind| Reconstruction::new().indicator(kind);
    let mut frames = [
        by(IndicatorKind::Cloud),
        by(IndicatorKind::Counting),
        by(IndicatorKind::Symmetry).domain([0.0; 3], [3.0; 3]),
        by(IndicatorKind::Cloud).periodic([Some([0.0, 40.0]), None, None]),
    ]
    .map(|request| packed(request, 20, None))
    .to_vec();
    let mut first = frames[1].clone();
    first[8] = 1;
    frames.push(sealed(&first));
    checked(frames)
}

/// Small seed frames of particles of several sizes, without and with walls. There are few
/// particles, because every size has its own samples, which take long to read.
fn of_several_sizes() -> Vec<Vec<u8>> {
    let frames = [Reconstruction::new(), Reconstruction::new().domain([-9.0; 3], [9.0; 3])]
        .map(|request| packed(request, 4, Some(&[1.0, 1.0, 2.0, 5.0])));
    checked(frames.to_vec())
}

/// Returns `seeds`, after checking that each is a valid frame.
fn checked(seeds: Vec<Vec<u8>>) -> Vec<Vec<u8>> {
    for seed in &seeds {
        assert!(open_frame(&folder::file("seed.mnf", seed), 0, None).is_ok(), "a seed is invalid");
    }
    seeds
}

fn plain() -> Vec<Vec<u8>> {
    [of_one_size(), of_several_sizes()].concat().iter().map(|frame| unbuilt(frame)).collect()
}
