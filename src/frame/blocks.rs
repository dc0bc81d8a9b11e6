//! The surfaces of a frame's blocks, batch by batch, within their share of memory.

use std::io;
use std::path::Path;

use crate::estimate::{BLOCKS_A_THREAD, spray_bytes};
use crate::grid::CellBox;
use crate::mesh::BlockMesh;
use crate::mesh::spool::Spool;

/// Blocks that are meshed at once, at the most.
const BATCH: usize = 1024;

/// Meshes `regions`, in Morton order, into `spool`, which moves to a scratch file in `folder` once it exceeds `share` bytes.
/// As many blocks are meshed at once as fit into what is left of them; there is always room for some a thread.
pub(super) fn mesh_blocks(
    spool: &mut Spool,
    mut regions: &[CellBox],
    share: u64,
    folder: &Path,
    mesh: impl Fn(&[CellBox]) -> io::Result<Vec<BlockMesh>>,
) -> io::Result<()> {
    let least = BLOCKS_A_THREAD * rayon::current_num_threads();
    while !regions.is_empty() {
        let left = share.saturating_sub(spool.bytes_in_memory());
        let fitting = usize::try_from(left / spray_bytes(spool.vertex_bytes())).unwrap_or(BATCH);
        let (batch, later) = regions.split_at(fitting.min(BATCH).max(least).min(regions.len()));
        mesh(batch)?.into_iter().try_for_each(|block| spool.push(block))?;
        if spool.bytes_in_memory() > share {
            spool.move_to_file(folder)?;
        }
        regions = later;
    }
    Ok(())
}
