//! Formats of particle files, and the extensions of each format.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::compression::plain_name;

/// A format of particle files.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum), value(rename_all = "lower"))]
pub enum InputFormat {
    /// Houdini's .bgeo (also the classic format), .bgeo.sc and .geo.
    Bgeo,
    /// DualSPHysics' .bi4.
    Bi4,
    /// Text tables, such as .csv, .txt and .dat.
    Csv,
    /// HDF5: VTKHDF, SWIFT, GADGET, openPMD, PySPH, H5Part, H5MD, or any other file with particles
    /// in groups or tables.
    Hdf5,
    /// A list of positions in JSON.
    Json,
    /// LAMMPS dumps in text.
    Lammps,
    /// A NumPy array.
    Npy,
    /// Several NumPy arrays in one file.
    Npz,
    /// Stanford's .ply.
    Ply,
    /// VTK files that list other files: .pvtp and .pvtu (pieces), .vtm, .vtpd and .vtpc (blocks).
    Pvtp,
    /// Tecplot text files.
    Tecplot,
    /// Legacy VTK.
    Vtk,
    /// VTK XML: .vtp and .vtu.
    Vtp,
    /// XYZ text, or raw 32-bit floats without a header, three for each particle.
    Xyz,
}

impl InputFormat {
    /// The format that the extension of `path` implies. A final `.gz`, `.xz` or `.zst` is ignored.
    #[must_use]
    pub fn of(path: &Path) -> Option<Self> {
        Some(match extension(path)?.as_str() {
            "bgeo" | "bhclassic" | "geo" | "sc" => Self::Bgeo,
            "bi4" => Self::Bi4,
            "csv" | "dat" | "txt" => Self::Csv,
            "dump" | "lammpstrj" => Self::Lammps,
            "h5" | "h5md" | "h5part" | "hdf" | "hdf5" | "vtkhdf" => Self::Hdf5,
            "json" => Self::Json,
            "npy" => Self::Npy,
            "npz" => Self::Npz,
            "ply" => Self::Ply,
            "pvtp" | "pvtu" | "vtm" | "vtpc" | "vtpd" => Self::Pvtp,
            "vtk" => Self::Vtk,
            "vtp" | "vtu" => Self::Vtp,
            "extxyz" | "xyz" => Self::Xyz,
            _ => return None,
        })
    }
}

/// The extension in lower case. A final compression extension such as `.gz` is ignored.
pub(super) fn extension(path: &Path) -> Option<String> {
    let name = path.file_name()?.to_string_lossy().to_ascii_lowercase();
    let (_, extension) = plain_name(&name).rsplit_once('.')?;
    Some(extension.to_owned())
}
