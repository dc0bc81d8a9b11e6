//! The surfaces of all blocks, in Morton order: in memory, or in a scratch file if they are large.

use std::borrow::Cow;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use glam::IVec3;

use crate::grid::{BLOCK_TILES, BlockLevel, MortonKey};
use crate::system::reopened::ReopenedFile;
use crate::system::scratch::Scratch;

use super::{BlockMesh, Tile};

/// Where the surface of a block is stored, and the numbers of its first vertex and its first
/// triangle in the whole mesh.
#[derive(Debug, Clone, Copy)]
struct SpoolEntry {
    block: IVec3,
    level: BlockLevel,
    first_vertex: u64,
    first_triangle: u64,
    tiles: u32,
    vertices: u32,
    triangles: u32,
    /// The byte offset of the surface in its file; 0 if the surface is in memory.
    at: u64,
}

/// Block surfaces in insertion order, which must be the order of [`block_place`].
#[derive(Debug)]
pub struct Spool {
    index: Vec<SpoolEntry>,
    store: BlockStore,
    /// Number of components of each vertex attribute.
    components: Vec<usize>,
    normals: bool,
    /// Size of all surfaces, in bytes.
    bytes: u64,
    /// The folder for scratch files, if the surfaces are in files.
    folder: Option<PathBuf>,
}

#[derive(Debug)]
enum BlockStore {
    Memory(Vec<BlockMesh>),
    File(Scratch),
    /// Each file with the number of its first block.
    Files(Vec<(usize, ReopenedFile)>),
}

/// An entry in the block list of a file that contains the surfaces of several blocks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct ListedBlock {
    /// The block's coordinates, in blocks of its level.
    pub block: [i32; 3],
    /// Number of tiles.
    pub tiles: u32,
    /// Number of vertices.
    pub vertices: u32,
    /// Number of triangles.
    pub triangles: u32,
    /// The level of the block's cells, [packed](BlockLevel::packed).
    pub level: u32,
}

/// The surfaces of consecutive blocks in a file.
#[derive(Debug)]
pub struct SpoolFile {
    /// The file.
    pub file: ReopenedFile,
    /// The byte offset of the first surface.
    pub at: u64,
    /// The list of the blocks, in Morton order.
    pub blocks: Vec<ListedBlock>,
}

impl ListedBlock {
    /// Size of the block's surface, in bytes. `vertex_bytes` is the size of a vertex without its
    /// tile.
    pub fn bytes(&self, vertex_bytes: u64) -> u64 {
        u64::from(self.tiles) * size_of::<Tile>() as u64 + u64::from(self.vertices) * vertex_bytes
    }
}

/// Size, in bytes, of a vertex without its tile: the samples of its edge, its normal, and its
/// attributes.
pub fn vertex_bytes(normals: bool, components: &[usize]) -> u64 {
    let normal = if normals { size_of::<[f32; 3]>() } else { 0 };
    let attributes = components.iter().sum::<usize>() * size_of::<f32>();
    (size_of::<[u16; 2]>() + normal + attributes) as u64
}

/// Estimated size, in bytes, of a surface's tiles, divided by its number of vertices.
pub const TILE_BYTES_PER_VERTEX: u64 = 4;

/// Size, in bytes, of the surfaces of `blocks` blocks that have `vertices` vertices in total and
/// contain the surface in every tile. Each vertex takes `vertex_bytes` bytes without its tile.
pub fn blocks_bytes(blocks: u64, vertices: u64, vertex_bytes: u64) -> u64 {
    vertices * vertex_bytes + blocks * u64::from(BLOCK_TILES) * size_of::<Tile>() as u64
}

impl Spool {
    /// A spool for surfaces in memory, with or without normals. `components` has the number of
    /// components of each vertex attribute.
    pub fn in_memory(normals: bool, components: Vec<usize>) -> Self {
        Self {
            index: Vec::new(),
            store: BlockStore::Memory(Vec::new()),
            components,
            normals,
            bytes: 0,
            folder: None,
        }
    }

    /// Size, in bytes, of a block's entry in the index of a spool.
    pub const BLOCK_BYTES: u64 = size_of::<SpoolEntry>() as u64;

    /// A spool for surfaces in files. The blocks of all files together must be in Morton order.
    /// `folder` is for scratch files.
    pub fn in_files(
        normals: bool,
        components: Vec<usize>,
        files: Vec<SpoolFile>,
        folder: &Path,
    ) -> Self {
        let mut spool = Self::in_memory(normals, components);
        spool.folder = Some(folder.to_owned());
        let vertex_bytes = spool.vertex_bytes();
        let mut stored = Vec::new();
        for SpoolFile { file, mut at, blocks } in files {
            stored.push((spool.len(), file));
            for block in blocks {
                spool.list(block, at);
                at += block.bytes(vertex_bytes);
            }
        }
        spool.store = BlockStore::Files(stored);
        spool
    }

    /// Adds a block to the index. `at` is the byte offset of the block's surface, if it is in a
    /// file.
    fn list(&mut self, listed: ListedBlock, at: u64) {
        let ListedBlock { block, tiles, vertices, triangles, level } = listed;
        let (first_vertex, first_triangle) = (self.vertices(), self.triangles());
        self.bytes += listed.bytes(self.vertex_bytes());
        self.index.push(SpoolEntry {
            block: block.into(),
            level: BlockLevel::unpacked(level).expect("levels are checked when they are read"),
            first_vertex,
            first_triangle,
            tiles,
            vertices,
            triangles,
            at,
        });
    }

    /// All blocks, as entries for the block list of a file.
    pub fn listed(&self) -> impl ExactSizeIterator<Item = ListedBlock> + '_ {
        self.index.iter().map(|&SpoolEntry { block, level, tiles, vertices, triangles, .. }| {
            ListedBlock {
                block: block.to_array(),
                tiles,
                vertices,
                triangles,
                level: level.packed(),
            }
        })
    }

    /// Writes the surfaces of all blocks.
    ///
    /// # Errors
    /// If a file with surfaces cannot be read, or `out` cannot be written.
    pub fn write_all(&self, out: &mut dyn Write) -> io::Result<()> {
        (0..self.len()).try_for_each(|i| out.write_all(&self.get(i)?.to_bytes()))
    }

    /// Size, in bytes, of all surfaces, in memory or in files.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Size, in bytes, of the surfaces that are in memory.
    pub fn bytes_in_memory(&self) -> u64 {
        match self.store {
            BlockStore::Memory(_) => self.bytes,
            BlockStore::File(_) | BlockStore::Files(_) => 0,
        }
    }

    /// Size, in bytes, of a vertex without its tile.
    pub fn vertex_bytes(&self) -> u64 {
        vertex_bytes(self.normals, &self.components)
    }

    /// Moves all surfaces to a scratch file in `folder`. Later surfaces are added to the same file.
    ///
    /// # Errors
    /// If the scratch file cannot be created or written.
    pub fn move_to_file(&mut self, folder: &Path) -> io::Result<()> {
        let BlockStore::Memory(blocks) = &mut self.store else { return Ok(()) };
        let blocks = std::mem::take(blocks);
        let scratch = Scratch::in_folder(folder)?;
        for (entry, block) in self.index.iter_mut().zip(blocks) {
            entry.at = scratch.append(&block.to_bytes())?;
        }
        self.store = BlockStore::File(scratch);
        self.folder = Some(folder.to_owned());
        Ok(())
    }

    /// The folder for scratch files, if the surfaces are in files.
    pub fn scratch_folder(&self) -> Option<&Path> {
        self.folder.as_deref()
    }

    /// Adds the next block's surface.
    ///
    /// # Errors
    /// If the scratch file cannot be written.
    pub fn push(&mut self, block: BlockMesh) -> io::Result<()> {
        let listed = ListedBlock {
            block: block.block.to_array(),
            tiles: block.tiles.len() as u32,
            vertices: block.ends.len() as u32,
            triangles: block.triangle_count as u32,
            level: block.level.packed(),
        };
        let at = match &mut self.store {
            BlockStore::Memory(blocks) => {
                blocks.push(block);
                0
            }
            BlockStore::File(scratch) => scratch.append(&block.to_bytes())?,
            BlockStore::Files(_) => unreachable!("no block is added to a spool in files"),
        };
        self.list(listed, at);
        Ok(())
    }

    /// Number of blocks.
    pub fn len(&self) -> usize {
        self.index.len()
    }

    /// Whether there is no surface.
    pub fn is_empty(&self) -> bool {
        self.index.is_empty()
    }

    /// Total number of vertices in all blocks.
    pub fn vertices(&self) -> u64 {
        self.index.last().map_or(0, |e| e.first_vertex + u64::from(e.vertices))
    }

    /// Total number of triangles in all blocks.
    pub fn triangles(&self) -> u64 {
        self.index.last().map_or(0, |e| e.first_triangle + u64::from(e.triangles))
    }

    /// Number of components of each vertex attribute.
    pub fn components(&self) -> &[usize] {
        &self.components
    }

    /// Whether vertices have normals.
    pub fn has_normals(&self) -> bool {
        self.normals
    }

    /// The coordinates of every block, in blocks of the block's level, and that level.
    pub fn blocks(&self) -> impl Iterator<Item = (IVec3, BlockLevel)> + '_ {
        self.index.iter().map(|entry| (entry.block, entry.level))
    }

    /// The coordinates of block number `i`, in blocks of its level.
    pub fn block(&self, i: usize) -> IVec3 {
        self.index[i].block
    }

    /// The level of block number `i`.
    pub fn level(&self, i: usize) -> BlockLevel {
        self.index[i].level
    }

    /// The number, in the whole mesh, of the first vertex of block number `i`.
    pub fn first_vertex(&self, i: usize) -> u64 {
        self.index[i].first_vertex
    }

    /// The number of the block that contains a vertex of the whole mesh.
    pub fn piece_of(&self, vertex: u64) -> usize {
        self.index.partition_point(|entry| entry.first_vertex <= vertex) - 1
    }

    /// The numbers of vertices and triangles in block number `i`.
    pub fn counts(&self, i: usize) -> [usize; 2] {
        [self.index[i].vertices as usize, self.index[i].triangles as usize]
    }

    /// The number of the block at `coord`, in blocks of `level`, if it contains the surface.
    pub fn find(&self, coord: IVec3, level: u8) -> Option<usize> {
        let place = block_place(coord, BlockLevel { level, ..BlockLevel::default() });
        self.index.binary_search_by_key(&place, |entry| block_place(entry.block, entry.level)).ok()
    }

    /// The tiles of block number `i`.
    ///
    /// # Errors
    /// If the scratch file cannot be read.
    pub fn tiles(&self, i: usize) -> io::Result<Cow<'_, [Tile]>> {
        match &self.store {
            BlockStore::Memory(blocks) => Ok(Cow::Borrowed(&blocks[i].tiles)),
            BlockStore::File(scratch) => self.read_tiles(scratch, i),
            BlockStore::Files(files) => self.read_tiles(file_of(files, i), i),
        }
    }

    fn read_tiles(&self, file: &impl ReadAt, i: usize) -> io::Result<Cow<'_, [Tile]>> {
        let mut at = self.index[i].at;
        read_array(file, &mut at, self.index[i].tiles as usize).map(Cow::Owned)
    }

    /// The surface of block number `i`.
    ///
    /// # Errors
    /// If the scratch file cannot be read.
    pub fn get(&self, i: usize) -> io::Result<Cow<'_, BlockMesh>> {
        match &self.store {
            BlockStore::Memory(blocks) => Ok(Cow::Borrowed(&blocks[i])),
            BlockStore::File(scratch) => self.read(scratch, &self.index[i]).map(Cow::Owned),
            BlockStore::Files(files) => {
                self.read(file_of(files, i), &self.index[i]).map(Cow::Owned)
            }
        }
    }

    fn read(&self, file: &impl ReadAt, entry: &SpoolEntry) -> io::Result<BlockMesh> {
        let mut at = entry.at;
        let vertices = entry.vertices as usize;
        let tiles = read_array(file, &mut at, entry.tiles as usize)?;
        let ends = read_array(file, &mut at, vertices)?;
        let normals = read_array(file, &mut at, if self.normals { vertices } else { 0 })?;
        let attributes = self.components.iter().map(|n| read_array(file, &mut at, n * vertices));
        Ok(BlockMesh {
            block: entry.block,
            level: entry.level,
            tiles,
            ends,
            normals,
            attributes: attributes.collect::<io::Result<_>>()?,
            triangle_count: entry.triangles as usize,
        })
    }
}

/// The place of a block in the order of a spool. Blocks are ordered by the last of the finest
/// blocks that they contain, so a block's triangles refer only to vertices of the block itself and
/// of later blocks.
pub fn block_place(block: IVec3, level: BlockLevel) -> (MortonKey, u8) {
    (MortonKey::of(level.first_block(block + 1) - 1), level.level)
}

/// The file that contains block number `i`.
fn file_of(files: &[(usize, ReopenedFile)], i: usize) -> &ReopenedFile {
    &files[files.partition_point(|&(first, _)| first <= i) - 1].1
}

/// Bytes that can be read by position.
trait ReadAt {
    fn read_at(&self, at: u64, bytes: &mut [u8]) -> io::Result<()>;
}

impl ReadAt for Scratch {
    fn read_at(&self, at: u64, bytes: &mut [u8]) -> io::Result<()> {
        self.read_at(at, bytes)
    }
}

impl ReadAt for ReopenedFile {
    fn read_at(&self, at: u64, bytes: &mut [u8]) -> io::Result<()> {
        Ok(self.read_exact_at(at, bytes)?)
    }
}

fn read_array<T: bytemuck::Pod>(
    file: &impl ReadAt,
    at: &mut u64,
    len: usize,
) -> io::Result<Vec<T>> {
    let mut array = vec![T::zeroed(); len];
    file.read_at(*at, bytemuck::cast_slice_mut(&mut array))?;
    *at += size_of_val(&array[..]) as u64;
    Ok(array)
}

impl BlockMesh {
    /// The bytes of all arrays, in the order in which [`Spool::get`] reads them.
    fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(self.bytes() as usize);
        bytes.extend_from_slice(bytemuck::cast_slice(&self.tiles));
        bytes.extend_from_slice(bytemuck::cast_slice(&self.ends));
        bytes.extend_from_slice(bytemuck::cast_slice(&self.normals));
        self.attributes
            .iter()
            .for_each(|values| bytes.extend_from_slice(bytemuck::cast_slice(values)));
        bytes
    }

    /// Size of all arrays, in bytes.
    fn bytes(&self) -> u64 {
        let attributes: usize = self.attributes.iter().map(|values| size_of_val(&values[..])).sum();
        let own = size_of_val(&self.tiles[..])
            + size_of_val(&self.ends[..])
            + size_of_val(&self.normals[..]);
        (own + attributes) as u64
    }
}
