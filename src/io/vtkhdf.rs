//! Writes meshes as VTKHDF, a layout of HDF5. A mesh is stored as PolyData with one partition.
//! Every data set is contiguous.
//!
//! All sizes are known in advance, so the file is written sequentially. It consists of the
//! superblock (version 0), the headers of all groups and data sets (version 1, with the links in
//! them), and the data. The module `h5` and other HDF5 readers can read the file.

use std::io::{self, Write};

use crate::surface::mesh::source::MeshSource;

use super::CoordinateWidth;
use super::columns::Scalar;
use super::vtp::arrays::{Array, point_data, points, polygons};

/// HDF5's undefined address.
const UNDEFINED: u64 = u64::MAX;
/// Size of the superblock in bytes.
const SUPERBLOCK: u64 = 96;

/// Writes `mesh` with all of its attributes, little-endian.
///
/// Points are f32 or f64 according to `width`. Indices have 32 bits if they fit, and otherwise 64.
///
/// A slash in a name, which HDF5 reserves for paths, becomes an underscore.
///
/// # Panics
/// Like [`MeshFormat::write`](crate::io::output::MeshFormat::write).
pub fn write_mesh(
    out: &mut dyn Write,
    mesh: &dyn MeshSource,
    width: CoordinateWidth,
) -> io::Result<()> {
    let root = root(mesh, width);
    let headers = root.header_bytes();
    let mut out = CountingOutput { out, at: 0 };
    let mut data = SUPERBLOCK + headers;
    let mut encoded = Vec::new();
    root.encode(SUPERBLOCK, &mut data, &mut encoded);
    out.write_all(&superblock(data))?;
    out.write_all(&encoded)?;
    root.write_data(&mut out, mesh)
}

/// The name of an object in a group, and the object.
type Link = (String, Node);

enum Node {
    Group { links: Vec<Link>, attributes: Vec<HdfAttribute> },
    Set { scalar: Scalar, shape: Vec<u64>, data: DatasetContent, role: Option<&'static str> },
}

enum DatasetContent {
    /// Integers that the file stores as i64.
    Counts(Vec<u64>),
    Array(Array<'static>),
    /// An array of offsets. The first offset is 0. Each further offset is the end of a triangle's
    /// corners in the array of all corners.
    Ends(Array<'static>),
}

enum HdfAttribute {
    Text(&'static str, &'static str),
    Counts(&'static str, [u64; 2]),
}

fn root(mesh: &dyn MeshSource, width: CoordinateWidth) -> Node {
    let (vertices, triangles) = (mesh.vertex_count(), mesh.triangle_count());
    let [corners, ends] = polygons(mesh);
    let faces = |cells: u64, corners: Node, ends: Node| {
        group(vec![
            ("Connectivity", corners),
            ("NumberOfCells", counts(&[cells])),
            ("NumberOfConnectivityIds", counts(&[3 * cells])),
            ("Offsets", ends),
        ])
    };
    let none = || faces(0, counts(&[]), counts(&[0]));
    let ends = Node::Set {
        scalar: ends.scalar(),
        shape: vec![triangles + 1],
        data: DatasetContent::Ends(ends),
        role: None,
    };
    let data = point_data(mesh, with_underscores)
        .into_iter()
        .map(|array| (array.name.clone(), set(array)));
    let vtk = Node::Group {
        links: vec![
            ("Lines".to_owned(), none()),
            ("NumberOfPoints".to_owned(), counts(&[vertices])),
            ("PointData".to_owned(), Node::Group { links: data.collect(), attributes: Vec::new() }),
            ("Points".to_owned(), set(points(mesh, width))),
            ("Polygons".to_owned(), faces(triangles, set(corners), ends)),
            ("Strips".to_owned(), none()),
            ("Vertices".to_owned(), none()),
        ],
        attributes: vec![
            HdfAttribute::Text("Type", "PolyData"),
            HdfAttribute::Counts("Version", [2, 0]),
        ],
    };
    group(vec![("VTKHDF", vtk)])
}

/// Replaces slashes, which HDF5 reserves for paths, by underscores.
pub(super) fn with_underscores(name: &str) -> String {
    name.replace('/', "_")
}

fn group(links: Vec<(&str, Node)>) -> Node {
    let links = links.into_iter().map(|(name, node)| (name.to_owned(), node)).collect();
    Node::Group { links, attributes: Vec::new() }
}

fn counts(values: &[u64]) -> Node {
    Node::Set {
        scalar: Scalar::I64,
        shape: vec![values.len() as u64],
        data: DatasetContent::Counts(values.to_vec()),
        role: None,
    }
}

fn set(array: Array<'static>) -> Node {
    let components = array.components as u64;
    let shape = match components {
        1 => vec![array.length],
        // An array of tuples has two axes. `max` avoids a division by 0 for arrays with 0
        // components.
        _ => vec![array.length / components.max(1), components],
    };
    let (scalar, role) = (array.scalar(), array.role);
    Node::Set { scalar, shape, data: DatasetContent::Array(array), role }
}

impl Node {
    /// The object's header. `addresses` are the addresses of the linked objects, or of the data.
    fn messages(&self, addresses: &[u64]) -> Vec<u8> {
        let mut messages = Messages::default();
        match self {
            Self::Group { links, attributes } => {
                // Links are stored in the header, not in a heap.
                messages.add(
                    0x02,
                    &[&[0, 0], &UNDEFINED.to_le_bytes()[..], &UNDEFINED.to_le_bytes()].concat(),
                );
                messages.add(0x0a, &[0, 0]);
                for ((name, _), address) in links.iter().zip(addresses) {
                    let name = &name.as_bytes()[..name.len().min(usize::from(u16::MAX) / 2)];
                    let length = (name.len() as u16).to_le_bytes();
                    // A hard link whose name is UTF-8.
                    messages.add(
                        0x06,
                        &[&[1, 0x11, 1], &length[..], name, &address.to_le_bytes()].concat(),
                    );
                }
                attributes.iter().for_each(|attribute| messages.add(0x0c, &attribute.encoded()));
            }
            Self::Set { scalar, shape, role, .. } => {
                messages.add(0x01, &dataspace(shape));
                messages.add(0x03, &datatype(*scalar));
                // No fill value, because all data is written.
                messages.add(0x05, &[2, 2, 2, 0]);
                let (bytes, address) = (self.data_bytes(), addresses[0]);
                messages.add(
                    0x08,
                    &[&[3, 1], &address.to_le_bytes()[..], &bytes.to_le_bytes()].concat(),
                );
                // As in VTK's files, this attribute makes the array the active array of its kind,
                // such as the active normals.
                let role = role.map(|role| HdfAttribute::Text("Attribute", role));
                role.iter().for_each(|role| messages.add(0x0c, &role.encoded()));
            }
        }
        messages.with_prefix()
    }

    fn links(&self) -> &[Link] {
        match self {
            Self::Group { links, .. } => links,
            Self::Set { .. } => &[],
        }
    }

    /// Size of this object's header in bytes.
    fn own_bytes(&self) -> u64 {
        self.messages(&vec![0; self.links().len().max(1)]).len() as u64
    }

    /// Size, in bytes, of this object's header and of the headers of all objects below it.
    fn header_bytes(&self) -> u64 {
        self.own_bytes() + self.links().iter().map(|(_, node)| node.header_bytes()).sum::<u64>()
    }

    fn data_bytes(&self) -> u64 {
        match self {
            Self::Group { .. } => 0,
            Self::Set { scalar, shape, .. } => shape.iter().product::<u64>() * scalar.size() as u64,
        }
    }

    /// Appends the header of this object at address `at`, and then the headers of all objects below
    /// it. `data` is the next free address for data, which this function advances.
    fn encode(&self, at: u64, data: &mut u64, out: &mut Vec<u8>) {
        let bytes = self.data_bytes();
        let addresses = match self {
            Self::Set { .. } if bytes == 0 => vec![UNDEFINED],
            Self::Set { .. } => vec![std::mem::replace(data, *data + padded(bytes))],
            Self::Group { links, .. } => {
                let mut next = at + self.own_bytes();
                let place = |(_, node): &Link| {
                    let at = next;
                    next += node.header_bytes();
                    at
                };
                links.iter().map(place).collect()
            }
        };
        out.extend(self.messages(&addresses));
        for ((_, node), address) in self.links().iter().zip(addresses) {
            node.encode(address, data, out);
        }
    }

    /// Writes the data of this object and of all objects below it, in the same order as
    /// [`encode`](Self::encode).
    fn write_data(&self, out: &mut CountingOutput, mesh: &dyn MeshSource) -> io::Result<()> {
        match self {
            Self::Group { links, .. } => {
                links.iter().try_for_each(|(_, node)| node.write_data(out, mesh))
            }
            Self::Set { scalar, data, .. } => {
                match data {
                    DatasetContent::Counts(values) => {
                        values.iter().try_for_each(|value| out.write_all(&value.to_le_bytes()))?;
                    }
                    DatasetContent::Array(array) => array.write(out, mesh)?,
                    DatasetContent::Ends(array) => {
                        out.write_all(&[0; 8][..scalar.size()])?;
                        array.write(out, mesh)?;
                    }
                }
                out.pad()
            }
        }
    }
}

impl HdfAttribute {
    fn encoded(&self) -> Vec<u8> {
        let (name, kind, space, value) = match self {
            Self::Text(name, text) => {
                // A string without a terminator. Its type contains its length.
                let kind = [&[0x13, 1, 0, 0], &(text.len() as u32).to_le_bytes()[..]].concat();
                (name, kind, dataspace(&[]), text.as_bytes().to_vec())
            }
            Self::Counts(name, values) => {
                let value = values.iter().flat_map(|value| value.to_le_bytes()).collect();
                (name, datatype(Scalar::I64), dataspace(&[values.len() as u64]), value)
            }
        };
        let length = |bytes: usize| (bytes as u16).to_le_bytes();
        let mut encoded = vec![1, 0];
        for bytes in [name.len() + 1, kind.len(), space.len()] {
            encoded.extend(length(bytes));
        }
        for part in [&[name.as_bytes(), &[0]].concat(), &kind, &space] {
            encoded.extend(part);
            encoded.resize(padded(encoded.len() as u64) as usize, 0);
        }
        encoded.extend(value);
        encoded
    }
}

/// Collects the messages of an object's header.
#[derive(Default)]
struct Messages {
    bytes: Vec<u8>,
    count: u16,
}

impl Messages {
    fn add(&mut self, kind: u16, content: &[u8]) {
        let size = padded(content.len() as u64);
        self.bytes.extend(kind.to_le_bytes());
        self.bytes.extend((size as u16).to_le_bytes());
        self.bytes.extend([0; 4]);
        self.bytes.extend(content);
        self.bytes.resize(padded(self.bytes.len() as u64) as usize, 0);
        self.count += 1;
    }

    /// Returns the complete header of version 1, with a reference count of one.
    fn with_prefix(self) -> Vec<u8> {
        let mut header = vec![1, 0];
        header.extend(self.count.to_le_bytes());
        header.extend(1u32.to_le_bytes());
        header.extend((self.bytes.len() as u32).to_le_bytes());
        header.extend([0; 4]);
        header.extend(self.bytes);
        header
    }
}

/// `bytes` rounded up to a multiple of eight.
fn padded(bytes: u64) -> u64 {
    bytes.next_multiple_of(8)
}

fn dataspace(shape: &[u64]) -> Vec<u8> {
    let mut space = vec![1, shape.len() as u8, 0, 0, 0, 0, 0, 0];
    space.extend(shape.iter().flat_map(|extent| extent.to_le_bytes()));
    space
}

/// The header message that describes a number type: IEEE 754 or two's complement, little-endian.
fn datatype(scalar: Scalar) -> Vec<u8> {
    let size = scalar.size() as u8;
    let float = |sign: u8, exponent_at: u8, exponent: u8, bias: u16| {
        let [low, high] = bias.to_le_bytes();
        let head = [0x11, 0x20, sign, 0, size, 0, 0, 0];
        [&head[..], &[0, 0, 8 * size, 0, exponent_at, exponent, 0, exponent_at, low, high, 0, 0]]
            .concat()
    };
    match scalar {
        Scalar::F32 => float(31, 23, 8, 127),
        Scalar::F64 => float(63, 52, 11, 1023),
        Scalar::U8 | Scalar::U32 => vec![0x10, 0, 0, 0, size, 0, 0, 0, 0, 0, 8 * size, 0],
        _ => vec![0x10, 8, 0, 0, size, 0, 0, 0, 0, 0, 8 * size, 0],
    }
}

/// The superblock of a file that ends at byte `end`. The root's header follows the superblock.
fn superblock(end: u64) -> Vec<u8> {
    let mut block = b"\x89HDF\r\n\x1a\n\0\0\0\0\0\x08\x08\0".to_vec();
    // The superblock must contain the sizes of B-tree nodes, although the file contains no B-trees.
    block.extend([4, 0, 16, 0, 0, 0, 0, 0]);
    for address in [0, UNDEFINED, end, UNDEFINED, 0, SUPERBLOCK] {
        block.extend(address.to_le_bytes());
    }
    block.resize(SUPERBLOCK as usize, 0);
    block
}

/// An output that counts its bytes.
struct CountingOutput<'a> {
    out: &'a mut dyn Write,
    at: u64,
}

impl CountingOutput<'_> {
    fn pad(&mut self) -> io::Result<()> {
        let missing = padded(self.at) - self.at;
        self.write_all(&[0; 8][..missing as usize])
    }
}

impl Write for CountingOutput<'_> {
    fn write(&mut self, buffer: &[u8]) -> io::Result<usize> {
        let written = self.out.write(buffer)?;
        self.at += written as u64;
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}
