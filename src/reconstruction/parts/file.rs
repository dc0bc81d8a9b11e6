//! The file of a part: the meshes of its blocks in the format of a [`Spool`], the list of these
//! blocks, and counts for the report.
//!
//! ```text
//! meshes of all blocks, in Morton order       in the format of a `Spool`
//! list of the blocks                          28 bytes each: coordinates, counts, level of cells
//! list of bins that contain particles         24 bytes each: coordinates, particles, tiles
//! for each attribute, a count of particles    8 bytes each: particles without a value
//! end                                         64 bytes: counts of the above, plan, part, CRC-32
//! ```
//!
//! Numbers are in the byte order of the machine that writes the file. A machine with a different
//! byte order rejects the file, because the magic number does not match.

use std::fs::File;
use std::io::{self, Read, Write};
use std::path::Path;

use bytemuck::{Pod, Zeroable};
use crc32fast::Hasher;

use crate::error::PartsError;
use crate::frame::{OccupiedBin, OccupiedTiles};
use crate::grid::BlockLevel;
use crate::grid::stretch::Stretch;
use crate::surface::mesh::spool::{ListedBlock, Spool, SpoolFile, block_place, vertex_bytes};
use crate::system::reopened::ReopenedFile;

/// The characters `mncus_P` and the version of the format, as one number in the machine's byte
/// order.
const MAGIC: u64 = 0x3250_5f73_7563_6e6d;

/// Bytes per read when a whole file is checked.
const PIECE: usize = 1 << 18;

/// Identifies a part and its plan.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct PartMark {
    /// The plan's fingerprint.
    pub(super) plan: u32,
    pub(super) part: u32,
    pub(super) of: u32,
    pub(super) stretch: Stretch,
    pub(super) normals: bool,
}

/// The end of a part's file.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct End {
    /// Bytes of the file before this structure.
    bytes: u64,
    blocks: u64,
    bins: u64,
    attributes: u32,
    part: u32,
    of: u32,
    plan: u32,
    first: u64,
    magic: u64,
    /// Padding, always 0. A file with other bytes here is rejected.
    padding: u32,
    /// CRC-32 of all preceding bytes.
    crc: u32,
}

const END: u64 = size_of::<End>() as u64;

/// The results of a part.
pub(super) struct PartResults<'a> {
    pub(super) spool: Option<&'a Spool>,
    pub(super) occupied: Vec<OccupiedBin>,
    /// For each attribute, the number of particles without a value.
    pub(super) lacking: Vec<u64>,
}

impl PartResults<'_> {
    pub(super) fn write(&self, mark: PartMark, out: &mut dyn Write) -> io::Result<()> {
        let mut out = ChecksumWriter { out, bytes: 0, crc: Hasher::new() };
        let blocks: Vec<ListedBlock> =
            self.spool.map_or(Vec::new(), |spool| spool.listed().collect());
        self.spool.map_or(Ok(()), |spool| spool.write_all(&mut out))?;
        out.write_all(bytemuck::cast_slice(&blocks))?;
        out.write_all(bytemuck::cast_slice(&self.occupied))?;
        out.write_all(bytemuck::cast_slice(&self.lacking))?;
        let mut end = End {
            bytes: out.bytes,
            blocks: blocks.len() as u64,
            bins: self.occupied.len() as u64,
            attributes: self.lacking.len() as u32,
            part: mark.part,
            of: mark.of,
            plan: mark.plan,
            first: mark.stretch.first.0,
            magic: MAGIC,
            padding: 0,
            crc: 0,
        };
        let ChecksumWriter { out, mut crc, .. } = out;
        crc.update(&bytemuck::bytes_of(&end)[..END as usize - 4]);
        end.crc = crc.finalize();
        out.write_all(bytemuck::bytes_of(&end))
    }
}

/// A writer that computes the checksum of its output.
struct ChecksumWriter<'a> {
    out: &'a mut dyn Write,
    bytes: u64,
    crc: Hasher,
}

impl Write for ChecksumWriter<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.out.write(bytes)?;
        self.crc.update(&bytes[..written]);
        self.bytes += written as u64;
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}

/// A complete file of a part.
#[derive(Debug)]
pub(super) struct PartFile {
    pub(super) meshes: SpoolFile,
    pub(super) occupied: OccupiedTiles,
    pub(super) bins: u64,
    pub(super) lacking: Vec<u64>,
    pub(super) bytes: u64,
}

impl PartFile {
    /// Opens and checks the file of a part; `None` if the file does not exist. `components` lists
    /// the number of components of each attribute.
    pub(super) fn open(
        path: &Path,
        mark: PartMark,
        components: &[usize],
    ) -> Result<Option<Self>, PartsError> {
        let io = |fault: io::Error| PartsError::Io { path: path.to_owned(), fault };
        let damaged =
            |what: &str| PartsError::Damaged { path: path.to_owned(), what: what.to_owned() };
        let file = match File::open(path) {
            Ok(file) => file,
            Err(fault) if fault.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(fault) => return Err(io(fault)),
        };
        let end = match read_whole(&file).map_err(io)? {
            Ok(end) => end,
            Err(what) => return Err(damaged(what)),
        };
        if [end.plan, end.part, end.of] != [mark.plan, mark.part, mark.of]
            || end.first != mark.stretch.first.0
        {
            return Err(PartsError::OtherPlan(path.to_owned()));
        }
        let inconsistent = || damaged("its lists do not match its meshes");
        let lists = [
            end.blocks.checked_mul(size_of::<ListedBlock>() as u64),
            end.bins.checked_mul(size_of::<OccupiedBin>() as u64),
            Some(8 * u64::from(end.attributes)),
        ];
        let lists = lists.into_iter().try_fold(0_u64, |sum, bytes| sum.checked_add(bytes?));
        let meshes_end =
            lists.and_then(|lists| end.bytes.checked_sub(lists)).ok_or_else(inconsistent)?;
        let file = ReopenedFile::new(path, file).map_err(io)?;
        let mut at = meshes_end;
        let blocks: Vec<ListedBlock> = list(&file, &mut at, end.blocks).map_err(io)?;
        let occupied: Vec<OccupiedBin> = list(&file, &mut at, end.bins).map_err(io)?;
        let lacking: Vec<u64> = list(&file, &mut at, end.attributes.into()).map_err(io)?;
        let vertex = vertex_bytes(mark.normals, components);
        let meshes: u64 = blocks.iter().map(|block| block.bytes(vertex)).sum();
        let levels = blocks.iter().map(|block| BlockLevel::unpacked(block.level));
        let levels: Option<Vec<_>> = levels.collect();
        let levels = levels.ok_or_else(inconsistent)?;
        let placed = blocks.iter().zip(levels).map(|(block, level)| (block.block.into(), level));
        let placed: Vec<_> = placed.collect();
        let in_order = placed.is_sorted_by(|&a, &b| block_place(a.0, a.1) < block_place(b.0, b.1));
        let within = placed.iter().all(|&(block, level)| mark.stretch.contains(level.home(block)));
        if meshes != meshes_end || lacking.len() != components.len() || !in_order || !within {
            return Err(inconsistent());
        }
        let meshes = SpoolFile { file, at: 0, blocks };
        let occupied = occupied.into_iter().collect();
        Ok(Some(Self { meshes, occupied, bins: end.bins, lacking, bytes: end.bytes + END }))
    }
}

/// Reads a list of `count` elements at position `at`, and advances `at` past it.
fn list<T: Pod>(file: &ReopenedFile, at: &mut u64, count: u64) -> io::Result<Vec<T>> {
    let mut list = vec![T::zeroed(); count as usize];
    file.read_exact_at(*at, bytemuck::cast_slice_mut(&mut list))?;
    *at += size_of_val(&list[..]) as u64;
    Ok(list)
}

/// Reads a whole file, and returns its end, or the reason why the file is invalid.
fn read_whole(mut file: &File) -> io::Result<Result<End, &'static str>> {
    let len = file.metadata()?.len();
    let Some(before) = len.checked_sub(END) else { return Ok(Err("it is truncated")) };
    let (mut crc, mut left, mut buffer) = (Hasher::new(), before, vec![0; PIECE]);
    while left > 0 {
        let piece = &mut buffer[..left.min(PIECE as u64) as usize];
        file.read_exact(piece)?;
        crc.update(piece);
        left -= piece.len() as u64;
    }
    let mut end = End::zeroed();
    file.read_exact(bytemuck::bytes_of_mut(&mut end))?;
    crc.update(&bytemuck::bytes_of(&end)[..END as usize - 4]);
    Ok(if end.magic != MAGIC {
        Err("it is truncated, or is not a part of a mesh")
    } else if crc.finalize() != end.crc || end.bytes != before || end.padding != 0 {
        Err("its checksum is wrong")
    } else {
        Ok(end)
    })
}
