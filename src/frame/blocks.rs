//! The surfaces of a frame's blocks, batch by batch, within their share of memory.

use std::io;
use std::path::Path;

use crate::estimate::{BLOCKS_A_THREAD, most_block_bytes};
use crate::grid::CellBox;
use crate::mesh::BlockMesh;
use crate::mesh::spool::Spool;

/// Blocks that are meshed at once, at the most.
const BATCH: usize = 1024;

/// Meshes `regions`, in Morton order, into `spool`. Of `share` bytes a quarter is for blocks that are being meshed; what
/// exceeds the rest goes to a scratch file in `folder`.
pub(super) fn mesh_blocks(
    spool: &mut Spool,
    regions: &[CellBox],
    share: u64,
    folder: &Path,
    mesh: impl Fn(&[CellBox]) -> io::Result<Vec<BlockMesh>>,
) -> io::Result<()> {
    let fitting = share / 4 / most_block_bytes(spool.vertex_bytes());
    let fitting = usize::try_from(fitting).unwrap_or(BATCH).min(BATCH);
    for regions in regions.chunks(fitting.max(BLOCKS_A_THREAD * rayon::current_num_threads())) {
        mesh(regions)?.into_iter().try_for_each(|block| spool.push(block))?;
        if spool.bytes() > share - share / 4 {
            spool.move_to_file(folder)?;
        }
    }
    Ok(())
}
