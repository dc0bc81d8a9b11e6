//! Reads and writes mesh files. Selects the writer and the reader of each format, and defines the
//! limits of each format.

use std::fmt;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use crate::particles::AttributeInfo;
use crate::surface::mesh::Mesh;
use crate::surface::mesh::source::MeshSource;

use super::beside::FolderInProgress;
use super::bytes::{Bytes, open_bytes, open_whole};
use super::compression::plain_name;
use super::input_format::InputFormat;
use super::vtp::divided::{Divided, MOST_TRIANGLES};
use super::whole::{FilledFile, MadeFolders, Replace, WholeFile, fault_of};
use super::{CoordinateWidth, ReadError, ReadFault, UpAxis, WriteError, WriteFault};
use super::{alembic, glb, houdini, obj, ply, stl, usd, vdb, vtk, vtkhdf, vtp};

/// The format of a mesh file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum MeshFormat {
    Ply,
    Obj,
    Vtk,
    Vtp,
    /// The format .pvtp: a list of .vtp files in a folder next to the list.
    Pvtp,
    VtkHdf,
    Stl,
    Usdc(UpAxis),
    Glb(glb::GlbLayout),
    /// Houdini's .bgeo.sc, compressed by Blosc.
    BgeoSc,
    /// Alembic's .abc, with one sample at this time.
    Abc(alembic::SampleTime),
    /// OpenVDB's .vdb with a level set. `zip` selects whether its values are compressed.
    Vdb {
        zip: bool,
    },
}

impl fmt::Display for MeshFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Ply => ".ply",
            Self::Obj => ".obj",
            Self::Vtk => ".vtk",
            Self::Vtp => ".vtp",
            Self::Pvtp => ".pvtp",
            Self::VtkHdf => ".vtkhdf",
            Self::Stl => ".stl",
            Self::Usdc(_) => ".usdc",
            Self::Glb(_) => ".glb",
            Self::BgeoSc => ".bgeo.sc",
            Self::Abc(_) => ".abc",
            Self::Vdb { .. } => ".vdb",
        })
    }
}

impl MeshFormat {
    /// All formats.
    const ALL: [Self; 12] = [
        Self::Ply,
        Self::Obj,
        Self::Vtk,
        Self::Vtp,
        Self::Pvtp,
        Self::VtkHdf,
        Self::Stl,
        Self::Usdc(UpAxis::Y),
        Self::Glb(glb::GlbLayout::PLAIN),
        Self::BgeoSc,
        Self::Abc(alembic::SampleTime::ZERO),
        Self::Vdb { zip: false },
    ];

    /// The extensions, for messages.
    pub const KNOWN: &'static str =
        ".ply, .obj, .vtk, .vtp, .pvtp, .vtkhdf, .stl, .usdc, .glb, .bgeo.sc, .abc and .vdb";

    /// The extensions of the meshes that this library can read, for messages.
    pub const KNOWN_MESHES: &'static str =
        ".ply, .obj, .vtk, .vtp, .pvtp, .vtkhdf, .stl, .bgeo, .bgeo.sc and .geo";

    /// The format that the extension of `path` implies. The case of the extension does not matter.
    #[must_use]
    pub fn of(path: &Path) -> Option<Self> {
        match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
            "ply" => Some(Self::Ply),
            "obj" => Some(Self::Obj),
            "vtk" => Some(Self::Vtk),
            "vtp" => Some(Self::Vtp),
            "pvtp" => Some(Self::Pvtp),
            "hdf" | "vtkhdf" => Some(Self::VtkHdf),
            "stl" => Some(Self::Stl),
            "usd" | "usdc" => Some(Self::Usdc(UpAxis::Y)),
            "glb" => Some(Self::Glb(glb::GlbLayout::PLAIN)),
            "abc" => Some(Self::Abc(alembic::SampleTime::ZERO)),
            "vdb" => Some(Self::Vdb { zip: false }),
            "sc" => {
                let before = Path::new(path.file_stem()?).extension()?;
                before.eq_ignore_ascii_case("bgeo").then_some(Self::BgeoSc)
            }
            _ => None,
        }
    }

    /// Sets the layout of a .glb, the up axis of a .usdc, and the compression of a .vdb. Returns
    /// other formats unchanged.
    #[must_use]
    pub fn with_layout(self, layout: glb::GlbLayout) -> Self {
        match self {
            Self::Glb(_) => Self::Glb(layout),
            Self::Usdc(_) => Self::Usdc(layout.up),
            Self::Vdb { .. } => {
                Self::Vdb { zip: layout.compression == glb::GlbCompression::Meshopt }
            }
            other => other,
        }
    }

    /// Sets the time of the mesh, in seconds, for formats that store a time.
    #[must_use]
    pub fn at(self, seconds: f64) -> Self {
        match self {
            Self::Abc(_) => Self::Abc(alembic::SampleTime::of(seconds)),
            other => other,
        }
    }

    /// Whether this library can read the format.
    #[must_use]
    pub fn is_read(self) -> bool {
        !matches!(self, Self::Usdc(_) | Self::Glb(_) | Self::Abc(_) | Self::Vdb { .. })
    }

    /// Whether the format can store normals of vertices.
    #[must_use]
    pub fn holds_normals(self) -> bool {
        !matches!(self, Self::Stl | Self::Vdb { .. })
    }

    /// Whether the format can store velocities and other attributes of vertices.
    #[must_use]
    pub fn holds_attributes(self) -> bool {
        !matches!(self, Self::Obj | Self::Stl)
    }

    /// Whether the format can store colours of vertices.
    #[must_use]
    pub fn holds_colours(self) -> bool {
        self != Self::Stl
    }

    /// For each attribute that the file stores under a different name, the attribute's name and the
    /// name in the file. A name changes if the format cannot store it or already uses it.
    /// Conventional changes are left out, such as the capitals of .glb, or Houdini's names for
    /// velocity and colour.
    #[must_use]
    pub fn renamed(self, attributes: &[AttributeInfo], has_normals: bool) -> Vec<[String; 2]> {
        let names = match self {
            Self::Ply => ply::attribute_names(attributes, has_normals),
            Self::Vtk => vtk::attribute_names(attributes, has_normals),
            Self::Vtp | Self::Pvtp => {
                vtp::arrays::attribute_names(attributes, has_normals, str::to_owned)
            }
            Self::VtkHdf => {
                vtp::arrays::attribute_names(attributes, has_normals, vtkhdf::with_underscores)
            }
            Self::BgeoSc => houdini::attribute_names(attributes, has_normals),
            Self::Abc(_) => alembic::attribute_names(attributes, has_normals),
            Self::Vdb { .. } => vdb::attribute_names(attributes),
            Self::Usdc(_) => return usd::renamed(has_normals, attributes),
            Self::Glb(_) => return glb::renamed(attributes),
            Self::Obj | Self::Stl => return Vec::new(),
        };
        let is_conventional =
            |name: &str| matches!(self, Self::Vdb { .. }) && vdb::HOUDINI_NAMES.contains(&name);
        let both = attributes.iter().zip(names);
        let both = both.filter(|(info, name)| info.name != *name && !is_conventional(name));
        both.map(|(info, name)| [info.name.clone(), name]).collect()
    }

    /// The attributes that the format cannot store, because they have too many components.
    #[must_use]
    pub fn not_stored(self, attributes: &[AttributeInfo]) -> Vec<AttributeInfo> {
        let is_left_out =
            |info: &&AttributeInfo| matches!(self, Self::Glb(_)) && !glb::can_store(info);
        attributes.iter().filter(is_left_out).cloned().collect()
    }

    /// Number of passes that the writer makes over the vertices of `mesh`, plus the number of
    /// passes over its triangles.
    pub(crate) fn readings(self, mesh: &dyn MeshSource) -> usize {
        let arrays = 1 + usize::from(mesh.has_normals()) + mesh.attributes().len();
        match self {
            // For a large .vdb, the pieces between two parts are read twice, which is not counted.
            Self::Ply | Self::Obj | Self::Stl | Self::Vdb { .. } => 2,
            // Reads the vertices once for each array (up to twice for a colour), and the triangles
            // once.
            Self::BgeoSc => arrays + 2,
            // Reads the vertices once for each array, and the triangles once.
            Self::Vtk | Self::Vtp | Self::Pvtp | Self::VtkHdf => arrays + 1,
            Self::Usdc(_) => usd::pass_count(mesh.has_normals(), &mesh.attributes()),
            // Reads vertices and triangles once more than other formats, to determine their order.
            Self::Glb(_) => 2 + arrays + 1,
            // Reads the vertices twice for each array, and the triangles twice.
            Self::Abc(_) => 2 * (arrays + 1),
        }
    }

    /// Whether the format can store coordinates in f64.
    #[must_use]
    pub fn holds_f64(self) -> bool {
        !matches!(self, Self::Stl | Self::Usdc(_) | Self::Abc(_))
    }

    /// Whether the writer keeps much of a mesh in memory. A .stl needs the positions of all
    /// vertices (24 bytes each), a compressed .glb needs all data to compress, and a .vdb needs
    /// parts of the mesh and often the values of all voxels. An uncompressed .glb needs 4 bytes per
    /// vertex. The other formats need a few pieces per thread.
    #[must_use]
    pub fn holds_whole_mesh(self) -> bool {
        let compressed =
            |layout: glb::GlbLayout| layout.compression == glb::GlbCompression::Meshopt;
        match self {
            Self::Stl | Self::Vdb { .. } => true,
            Self::Glb(layout) => compressed(layout),
            _ => false,
        }
    }

    /// Maximum number of vertices, and maximum number of triangles, in a file of this format.
    fn max_counts(self) -> [u64; 2] {
        const I32: u64 = i32::MAX as u64;
        const I64: u64 = i64::MAX as u64;
        const U32: u64 = u32::MAX as u64;
        match self {
            // Indices are u32.
            Self::Ply => [U32 + 1, u64::MAX],
            Self::Obj => [u64::MAX; 2],
            // Each triangle takes four numbers, and the file stores the count of these numbers as
            // an i32.
            Self::Vtk => [I32, I32 / 4],
            // The offset after the last triangle, three times the number of triangles, is an i64.
            Self::Vtp | Self::Pvtp | Self::VtkHdf | Self::BgeoSc => [I64, I64 / 3],
            Self::Stl => [u64::MAX, U32],
            Self::Vdb { .. } => [U32, U32 - 1],
            Self::Usdc(_) => [I32, u64::MAX / 3],
            // Sizes in bytes have 63 bits. A triangle takes 16 bytes. With this limit, triangles
            // take at most half of the greatest size.
            Self::Abc(_) => [I32, I64 / 32],
            // A file takes at most 4 GiB. Positions take 12 bytes per vertex, and indices 12 bytes
            // per triangle.
            Self::Glb(_) => [U32 / 12; 2],
        }
    }

    fn can_store_counts(self, vertices: u64, triangles: u64) -> bool {
        let [most_vertices, most_triangles] = self.max_counts();
        vertices <= most_vertices && triangles <= most_triangles
    }

    /// Checks that the format can store `vertices` vertices and `triangles` triangles.
    ///
    /// # Errors
    /// [`io::ErrorKind::InvalidInput`] if the format cannot store them. The message states the
    /// limit, and lists the formats that can store the mesh.
    pub fn check_counts(self, vertices: u64, triangles: u64) -> io::Result<()> {
        if self.can_store_counts(vertices, triangles) {
            return Ok(());
        }
        let limits = self.max_counts().into_iter().zip(["vertices", "triangles"]);
        let limits: Vec<_> = limits
            .filter(|(most, _)| *most < u64::MAX)
            .map(|(most, what)| format!("{most} {what}"))
            .collect();
        let able =
            Self::ALL.into_iter().filter(|format| format.can_store_counts(vertices, triangles));
        let able: Vec<_> = able.map(|format| format.to_string()).collect();
        let what = format!(
            "{vertices} vertices and {triangles} triangles are too many for {self}, which \
             stores at most {}; write {}",
            limits.join(" and "),
            able.join(" or "),
        );
        Err(io::Error::new(io::ErrorKind::InvalidInput, what))
    }

    /// Writes all data of `mesh` that the format can store, in several passes over its pieces.
    ///
    /// # Errors
    /// The errors of `mesh` and `out`, and the errors of [`check_counts`](Self::check_counts)
    /// before anything is written.
    ///
    /// # Panics
    /// If the number of normals or of values of an attribute does not match the number of vertices,
    /// the pieces are not complete, or a triangle refers to a missing vertex.
    pub fn write(
        self,
        out: &mut dyn Write,
        mesh: &dyn MeshSource,
        width: CoordinateWidth,
    ) -> io::Result<()> {
        self.check_counts(mesh.vertex_count(), mesh.triangle_count())?;
        match self {
            Self::Ply => ply::write_mesh(out, mesh, width),
            Self::Obj => obj::write_mesh(out, mesh, width),
            Self::Vtk => vtk::write_mesh(out, mesh, width),
            Self::Vtp => vtp::write_mesh(out, mesh, width),
            Self::Pvtp => Err(several_files()),
            Self::VtkHdf => vtkhdf::write_mesh(out, mesh, width),
            Self::Stl => stl::write_mesh(out, mesh, width),
            Self::Usdc(up) => usd::write_mesh(out, mesh, up),
            Self::Glb(layout) => glb::write_mesh(out, mesh, width, layout),
            Self::BgeoSc => houdini::write_mesh(out, mesh, width),
            Self::Abc(time) => alembic::write_mesh(out, mesh, time),
            Self::Vdb { zip } => vdb::write_mesh(out, mesh, zip),
        }
    }

    /// Reads a mesh from the bytes of a file.
    ///
    /// # Errors
    /// For damaged files, and for unsupported features of the format. This function never panics.
    pub fn read(self, bytes: &[u8]) -> Result<Mesh, ReadFault> {
        match self {
            Self::Ply => ply::read_mesh(bytes),
            Self::Obj => obj::read_mesh(bytes),
            Self::Vtk => vtk::read_mesh(bytes),
            Self::Vtp => vtp::read_mesh(bytes),
            Self::Pvtp => Err(ReadFault::Unsupported(several_files().to_string())),
            Self::VtkHdf => read_hdf(bytes.to_vec().into()),
            Self::Stl => stl::read_mesh(bytes),
            Self::BgeoSc => houdini::read_mesh(bytes.to_vec().into()),
            Self::Usdc(_) | Self::Glb(_) | Self::Abc(_) | Self::Vdb { .. } => {
                let what = format!(
                    "meniscus cannot read {self} meshes; save the mesh in another format, such as \
                     .ply"
                );
                Err(ReadFault::Unsupported(what))
            }
        }
    }
}

/// Reads the mesh at `path` in the format that its extension implies. The file may be compressed,
/// with or without a further extension such as `.gz`.
///
/// # Errors
/// The errors of [`MeshFormat::read`], [`ReadFault::Io`] if the file cannot be opened or read, and
/// [`ReadFault::UnknownExtension`].
pub fn read_mesh(path: &Path) -> Result<Mesh, ReadError> {
    let read = match mesh_format(path) {
        Some(MeshFormat::Pvtp) => return vtp::parallel::read_mesh(path),
        Some(MeshFormat::VtkHdf) => read_hdf(open_bytes(path)?),
        Some(format) if format != MeshFormat::BgeoSc => format.read(&open_whole(path)?),
        // Geometries of Houdini may also be uncompressed, or in text form.
        _ if InputFormat::of(path) == Some(InputFormat::Bgeo) => {
            houdini::read_mesh(open_bytes(path)?)
        }
        _ => Err(ReadFault::UnknownExtension { known: MeshFormat::KNOWN_MESHES }),
    };
    read.map_err(|fault| ReadError::new(path, fault))
}

/// The format of the mesh at `path`, whose extension may be followed by `.gz`, `.xz` or `.zst`.
/// `None` if no mesh has this extension.
pub fn mesh_format(path: &Path) -> Option<MeshFormat> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    MeshFormat::of(Path::new(plain_name(&name)))
}

/// An opened mesh, which is either in memory or streamed from its file.
pub enum OpenedMesh {
    /// The whole mesh in memory.
    Whole(Mesh),
    /// A mesh that is streamed from its .ply file.
    Streamed(Box<ply::StreamedMesh>),
}

impl OpenedMesh {
    /// The mesh as a source of pieces.
    pub fn source(&self) -> &dyn MeshSource {
        match self {
            Self::Whole(mesh) => mesh,
            Self::Streamed(mesh) => &**mesh,
        }
    }
}

/// Memory, in bytes per byte of a binary mesh file, that the contents of the file and the resulting
/// mesh need together.
const MEMORY_PER_FILE_BYTE: u64 = 3;

/// Opens the mesh at `path`. A .ply file that this library wrote is streamed if the whole mesh
/// would need more than `memory` bytes.
pub fn open_mesh(path: &Path, memory: u64) -> Result<OpenedMesh, ReadError> {
    let large = std::fs::metadata(path)
        .is_ok_and(|file| file.len().saturating_mul(MEMORY_PER_FILE_BYTE) > memory);
    if large && MeshFormat::of(path) == Some(MeshFormat::Ply) {
        let bytes = open_bytes(path)?;
        if let Bytes::File(_) = &bytes {
            let streamed = ply::StreamedMesh::open(bytes, open_bytes(path)?);
            if let Some(mesh) = streamed.map_err(|fault| ReadError::new(path, fault))? {
                return Ok(OpenedMesh::Streamed(Box::new(mesh)));
            }
        }
    }
    read_mesh(path).map(OpenedMesh::Whole)
}

#[cfg(feature = "hdf5")]
fn read_hdf(bytes: Bytes) -> Result<Mesh, ReadFault> {
    super::h5::read_mesh(bytes)
}

#[cfg(not(feature = "hdf5"))]
fn read_hdf(_: Bytes) -> Result<Mesh, ReadFault> {
    Err(super::input::no_hdf5())
}

fn several_files() -> io::Error {
    io::Error::new(
        io::ErrorKind::InvalidInput,
        "a .pvtp needs a folder for its pieces; choose another format",
    )
}

/// A mesh file that is prepared for writing.
#[derive(Debug)]
pub struct MeshOutput {
    file: WholeFile,
    format: MeshFormat,
}

impl MeshOutput {
    /// Checks, before the mesh is computed, that a mesh can be written to `path`. The extension
    /// selects the format. Pipes and devices need no extension. Without an extension, their format
    /// is .ply.
    ///
    /// # Errors
    /// [`WriteFault::UnknownExtension`], and the errors of [`WholeFile::prepare`].
    pub fn prepare(path: &Path, replace: Replace) -> Result<Self, WriteError> {
        let unknown =
            || WriteError::new(path, WriteFault::UnknownExtension { known: MeshFormat::KNOWN });
        let format = MeshFormat::of(path);
        if format.is_none() && path.extension().is_some() {
            return Err(unknown());
        }
        let file = WholeFile::prepare(path, replace)?;
        if format == Some(MeshFormat::Pvtp) {
            let fail = |fault| WriteError::new(path, fault_of(fault));
            let place = file.place().ok_or_else(|| fail(several_files()))?;
            FolderInProgress::check(place, PIECE, replace == Replace::Allow).map_err(fail)?;
        }
        let format = format.or(file.is_direct().then_some(MeshFormat::Ply)).ok_or_else(unknown)?;
        Ok(Self { file, format })
    }

    /// The format that the extension implies, or .ply for a pipe or device without an extension.
    pub fn format(&self) -> MeshFormat {
        self.format
    }

    /// Applies [`MeshFormat::with_layout`] to the format.
    pub fn with_layout(self, layout: glb::GlbLayout) -> Self {
        Self { format: self.format.with_layout(layout), ..self }
    }

    /// Applies [`MeshFormat::at`] to the format.
    pub fn at(self, seconds: f64) -> Self {
        Self { format: self.format.at(seconds), ..self }
    }

    /// The temporary file and the created folders, which an interrupt handler must remove.
    pub(crate) fn leftovers(&self, folders: &MadeFolders) -> Vec<PathBuf> {
        self.file.leftovers(folders)
    }

    /// Writes `mesh`. Returns the file's size in bytes.
    ///
    /// # Errors
    /// The errors of [`WholeFile::write`], and [`WriteFault::Unsupported`] for more vertices or
    /// triangles than the format can store.
    ///
    /// # Panics
    /// Like [`MeshFormat::write`].
    pub fn write(self, mesh: &dyn MeshSource, width: CoordinateWidth) -> Result<u64, WriteError> {
        self.fill(mesh, width)?.keep()
    }

    /// Writes `mesh` to the temporary file.
    ///
    /// # Errors
    /// The errors of [`WholeFile::fill`], and [`WriteFault::Unsupported`] for more vertices or
    /// triangles than the format can store.
    ///
    /// # Panics
    /// Like [`MeshFormat::write`].
    pub fn fill(
        self,
        mesh: &dyn MeshSource,
        width: CoordinateWidth,
    ) -> Result<FilledFile, WriteError> {
        let Self { file, format } = self;
        match format {
            MeshFormat::Pvtp => divide(file, mesh, width, MOST_TRIANGLES),
            _ => file.fill(|out| format.write(out, mesh, width)),
        }
    }
}

/// Extension of the files in the folder of a .pvtp.
const PIECE: &str = "vtp";

/// Writes a mesh as a list of files, each with at most `most` triangles.
fn divide(
    file: WholeFile,
    mesh: &dyn MeshSource,
    width: CoordinateWidth,
    most: u64,
) -> Result<FilledFile, WriteError> {
    let path = file.path().to_owned();
    let pieces = || -> io::Result<(FolderInProgress, Divided, Vec<String>)> {
        MeshFormat::Pvtp.check_counts(mesh.vertex_count(), mesh.triangle_count())?;
        let (place, temporary) = file.place().zip(file.temporary()).ok_or_else(several_files)?;
        let mut folder = FolderInProgress::begin(place, temporary, PIECE)?;
        let divided = Divided::new(mesh, width, most)?;
        for piece in 0..divided.pieces() {
            folder.write(piece, |out| divided.write(out, piece))?;
        }
        let names = (0..divided.pieces()).map(|piece| folder.name(piece)).collect();
        Ok((folder, divided, names))
    };
    let (folder, divided, names) =
        pieces().map_err(|fault| WriteError::new(&path, fault_of(fault)))?;
    Ok(file.fill(|out| divided.write_list(out, &names))?.after(folder))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::mesh::source::{Outline, Vertices};

    /// A mesh that reports large counts but has no data.
    struct HugeMesh {
        vertices: u64,
        triangles: u64,
    }

    impl MeshSource for HugeMesh {
        fn outline(&self) -> Outline {
            Outline {
                vertices: self.vertices,
                triangles: self.triangles,
                normals: true,
                attributes: Vec::new(),
                pieces: 1,
                lattice: None,
            }
        }

        fn vertices(&self, _: usize) -> io::Result<Vertices<'_>> {
            panic!("vertices were requested")
        }
        fn triangles(&self, _: usize) -> io::Result<Vec<[u64; 3]>> {
            panic!("triangles were requested")
        }
    }

    #[test]
    fn pieces_of_any_size_read_back_as_the_mesh_with_unique_vertices() {
        // An octahedron whose vertices each belong to four triangles, in no particular order.
        let corner = |axis: usize, sign: f64| -> [f64; 3] {
            std::array::from_fn(|k| if k == axis { sign } else { 0.0 })
        };
        let positions: Vec<_> =
            [0, 1, 2].into_iter().flat_map(|k| [corner(k, 1.0), corner(k, -1.0)]).collect();
        let triangles = vec![
            [0, 2, 4],
            [2, 1, 4],
            [1, 3, 4],
            [3, 0, 4],
            [2, 0, 5],
            [1, 2, 5],
            [3, 1, 5],
            [0, 3, 5],
        ];
        let values: Vec<f32> = (0..18).map(|i| i as f32).collect();
        let normals = values.as_chunks::<3>().0.to_vec();
        let velocity = crate::surface::mesh::VertexAttribute::new("velocity", 3, values);
        let mesh =
            Mesh { positions, triangles, normals: Some(normals), attributes: vec![velocity] };
        let faces = |mesh: &Mesh| -> Vec<_> {
            let vertex = |&v: &u32| {
                let normal = mesh.normals.as_ref().unwrap()[v as usize];
                (mesh.positions[v as usize], normal, mesh.attributes[0].values[3 * v as usize + 1])
            };
            mesh.triangles.iter().map(|t| t.each_ref().map(vertex)).collect()
        };
        for (most, pieces) in [(1, 8), (3, 3), (4, 2), (7, 2), (8, 1)] {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("o.pvtp");
            let file = WholeFile::prepare(&path, Replace::Refuse).unwrap();
            divide(file, &mesh, CoordinateWidth::F64, most).unwrap().keep().unwrap();
            assert_eq!(std::fs::read_dir(folder.path().join("o")).unwrap().count(), pieces);
            let read = read_mesh(&path).unwrap();
            assert_eq!((read.positions.len(), faces(&read)), (6, faces(&mesh)), "pieces of {most}");
            assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 2);
        }
    }

    #[test]
    fn a_mesh_too_large_for_a_format_is_refused_before_any_reading() {
        let mesh = HugeMesh { vertices: 1 << 33, triangles: 1 << 34 };
        for (format, limit) in [
            (MeshFormat::Ply, "at most 4294967296 vertices;"),
            (MeshFormat::Vtk, "at most 2147483647 vertices and 536870911 triangles;"),
            (MeshFormat::Stl, "at most 4294967295 triangles;"),
        ] {
            let mut out = Vec::new();
            let fault = format.write(&mut out, &mesh, CoordinateWidth::F32).unwrap_err();
            assert_eq!((fault.kind(), out.len()), (io::ErrorKind::InvalidInput, 0), "{format}");
            let message = fault.to_string();
            assert!(message.contains("8589934592 vertices and 17179869184 triangles"), "{message}");
            assert!(
                message.contains(limit)
                    && message.ends_with("write .obj or .vtp or .pvtp or .vtkhdf or .bgeo.sc"),
                "{message}"
            );
        }
        for format in [MeshFormat::Obj, MeshFormat::Vtp] {
            format.check_counts(mesh.vertices, mesh.triangles).unwrap();
        }
    }

    #[test]
    fn a_too_large_mesh_leaves_no_file_and_the_error_names_other_formats() {
        let folder = tempfile::tempdir().unwrap();
        let output = MeshOutput::prepare(&folder.path().join("a.vtk"), Replace::Refuse).unwrap();
        let mesh = HugeMesh { vertices: 1 << 31, triangles: 1 << 31 };
        let fault = output.write(&mesh, CoordinateWidth::F32).unwrap_err().fault;
        assert!(matches!(&fault, WriteFault::Unsupported(_)), "{fault}");
        assert!(
            fault.to_string().ends_with(
                "write .ply or .obj or .vtp or .pvtp or .vtkhdf or .stl or .bgeo.sc or .vdb"
            ),
            "{fault}"
        );
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn each_format_accepts_exactly_up_to_its_largest_mesh() {
        const U32: u64 = u32::MAX as u64;
        for (format, vertices, triangles) in [
            (MeshFormat::Ply, Some(U32 + 1), None),
            (MeshFormat::Vtk, Some(0x7fff_ffff), Some(0x1fff_ffff)),
            (MeshFormat::Vtp, Some(i64::MAX as u64), Some(i64::MAX as u64 / 3)),
            (MeshFormat::Stl, None, Some(U32)),
            (MeshFormat::Obj, None, None),
        ] {
            let most = [vertices, triangles].map(|most| most.unwrap_or(u64::MAX));
            format.check_counts(most[0], most[1]).unwrap();
            if let Some(vertices) = vertices {
                format.check_counts(vertices + 1, 0).unwrap_err();
            }
            if let Some(triangles) = triangles {
                format.check_counts(0, triangles + 1).unwrap_err();
            }
        }
    }
}
