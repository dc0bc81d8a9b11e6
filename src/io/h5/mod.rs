//! Reads HDF5 files with the layouts of common simulators.
//!
//! | layout | identified by | frames |
//! |---|---|---|
//! | VTKHDF | the group `VTKHDF` | its steps |
//! | openPMD | the attribute `openPMD` of the root | its iterations |
//! | SWIFT and GADGET | groups `Header` and `PartType0` to `PartType6` | one, in one file or in several |
//! | PySPH | groups `particles` and `solver_data` | one |
//! | H5Part | groups such as `Step#12` | its steps |
//! | H5MD, and others | data sets of equal length or a table, in a group | groups such as `frame_12`, groups of the root called `0012` or similar, or the first axis of the data sets |
//!
//! `sim.h5part#12` names one of several frames. The file's size bounds the memory for headers,
//! chunks and rows.

mod contents;
mod file;
mod groups;
mod h5md;
mod lzf;
mod openpmd;
mod pysph;
mod snapshot;
mod steps;
mod table;
mod vtkhdf;

use std::path::Path;

use crate::surface::mesh::Mesh;

use super::bytes::{Bytes, Unpacking};
use super::wanted::WantedParticles;
use super::{ParticleFile, ReadError, ReadFault};

use file::H5File;
pub use snapshot::pieces_of;

/// The layout of a file. A file without a known layout is searched for groups of particles.
enum H5Layout {
    VtkHdf,
    OpenPmd,
    Snapshot,
    PySph,
    Groups,
}

impl H5Layout {
    fn of(file: &H5File) -> Result<Self, ReadFault> {
        let root = file.root()?;
        let (groups, _) = file::convert_error(root.member_names())?;
        let has = |name: &str| groups.iter().any(|group| group == name);
        Ok(if has(vtkhdf::ROOT) {
            Self::VtkHdf
        } else if root.attribute("openPMD").is_ok() {
            Self::OpenPmd
        } else if has(snapshot::HEADER) && snapshot::has_snapshot_header(&root) {
            Self::Snapshot
        } else if has(pysph::PARTICLES) && has(pysph::SOLVER) {
            Self::PySph
        } else {
            Self::Groups
        })
    }
}

/// Reads a frame of the file at `path`. `bytes` must be the content of this file. The other files
/// of a snapshot are opened by their paths, which are derived from `path`.
///
/// # Errors
/// [`ReadFault::Unsupported`] if there are several steps or types of particles and none is chosen,
/// if the chosen step or type does not exist, and if no position is found. [`ReadFault::Malformed`]
/// if the file violates the HDF5 format or its layout, or if the components of the position differ
/// in length. [`ReadFault::Compression`] if the compression ratio is too high.
/// [`ReadFault::Scratch`] if the scratch file cannot be written. [`ReadFault::Io`] if a file of a
/// snapshot does not exist.
pub fn open_particles(
    path: &Path,
    bytes: Bytes,
    step: Option<u64>,
    wanted: WantedParticles,
    unpacking: Unpacking,
) -> Result<ParticleFile, ReadError> {
    let fail = |fault| ReadError::new(path, fault);
    let file = H5File::open(bytes, unpacking).map_err(fail)?;
    let layout = H5Layout::of(&file).map_err(fail)?;
    if let (H5Layout::Snapshot | H5Layout::PySph, Some(step)) = (&layout, step) {
        return Err(fail(ReadFault::Unsupported(format!(
            "the file contains a single frame, so there is no step {step}"
        ))));
    }
    match layout {
        H5Layout::VtkHdf => vtkhdf::read_particles(file, step, wanted.attributes).map_err(fail),
        H5Layout::OpenPmd => openpmd::read_particles(file, step, wanted).map_err(fail),
        H5Layout::Snapshot => snapshot::open_particles(path, file, wanted, unpacking),
        H5Layout::PySph => pysph::read_particles(file, wanted).map_err(fail),
        H5Layout::Groups => steps::read_particles(file, step, wanted).map_err(fail),
    }
}

/// The numbers of the frames in a file, in order. Empty for a file with a single frame.
///
/// # Errors
/// [`ReadFault::Malformed`] for a file that is not HDF5.
pub fn steps(bytes: Bytes) -> Result<Vec<u64>, ReadFault> {
    let file = H5File::open(bytes, Unpacking::in_memory())?;
    match H5Layout::of(&file)? {
        H5Layout::VtkHdf => vtkhdf::steps(&file),
        H5Layout::OpenPmd => openpmd::steps(&file),
        H5Layout::Snapshot | H5Layout::PySph => Ok(Vec::new()),
        H5Layout::Groups => steps::steps(&file),
    }
}

/// Whether a file contains a mesh: VTKHDF in which a cell has an area or a volume, or PolyData
/// without any points.
pub fn has_faces(bytes: Bytes) -> Result<bool, ReadFault> {
    let file = H5File::open(bytes, Unpacking::in_memory())?;
    match H5Layout::of(&file)? {
        H5Layout::VtkHdf => vtkhdf::has_faces(&file),
        _ => Ok(false),
    }
}

/// Reads the polygons of a VTKHDF file as a mesh. Each polygon becomes a fan of triangles around
/// its first corner.
///
/// # Errors
/// The errors of [`open_particles`], and [`ReadFault::Unsupported`] for strips, for several steps,
/// and for layouts and data sets other than PolyData in VTKHDF.
pub fn read_mesh(bytes: Bytes) -> Result<Mesh, ReadFault> {
    let file = H5File::open(bytes, Unpacking::in_memory())?;
    match H5Layout::of(&file)? {
        H5Layout::VtkHdf => vtkhdf::read_mesh(file),
        _ => Err(ReadFault::Unsupported("HDF5 meshes must be VTKHDF".to_owned())),
    }
}
