//! Writes one frame as a binary layer.

use std::io::{self, Write};
use std::ops::Range;
use std::sync::{Mutex, PoisonError};

use crate::io::UpAxis;
use crate::io::encode::{write_floats, write_pieces, write_triangles, write_vertices};
use crate::particles::{AttributeInfo, AttributeKind, colour_attribute};
use crate::surface::mesh::source::MeshSource;

use super::crate_file::{FLOAT, FileTail, HEADER, INT, UINT, UsdValue, VEC3F, header};
use super::{PRIM, UsdProperty, properties};

/// Number of triangles whose corner counts are encoded at once.
const COUNTS: u64 = 1 << 16;

/// Writes `mesh` as a .usdc layer.
///
/// Points are written as f32, as the schema requires. An attribute `velocity` of three components
/// is written as `velocities`, the first colour as `primvars:displayColor`, and its alpha as
/// `primvars:displayOpacity`. Other attributes become `primvars` under their own names, in which
/// underscores replace invalid characters.
///
/// The layer declares the up axis, and no data is rotated. The unit is 1 m, because the actual unit
/// is unknown.
///
/// # Panics
/// Like [`MeshFormat::write`](crate::io::output::MeshFormat::write).
pub fn write_mesh(out: &mut dyn Write, mesh: &dyn MeshSource, up: UpAxis) -> io::Result<()> {
    let properties = properties(mesh.has_normals(), &mesh.attributes());
    let arrays = arrays(mesh, properties.len());
    let mut end = HEADER;
    let mut place = |array: &UsdArray| {
        let at = end;
        end += array.bytes();
        at
    };
    let offsets: Vec<u64> = arrays.iter().map(&mut place).collect();
    let (tail, contents_at) = tail(&properties, &arrays, &offsets, end, up);

    out.write_all(&header(contents_at))?;
    let extent = Mutex::new([[f32::MAX; 3], [f32::MIN; 3]]);
    for array in &arrays {
        out.write_all(&array.length.to_le_bytes())?;
        array.write(out, mesh, &extent)?;
        out.write_all(&[0; 8][..array.padding() as usize])?;
    }
    out.write_all(&tail)
}

/// An array in the file. The arrays are in the order of the properties.
struct UsdArray {
    kind: u64,
    length: u64,
    /// Size of an element in bytes.
    width: u64,
    values: UsdValues,
}

enum UsdValues {
    Points,
    CornerCounts,
    Corners,
    Extent,
    Normals,
    /// The attribute with this index.
    Attribute(usize),
    /// Red, green and blue of the attribute with this index.
    Colour(usize),
    /// Alpha of the attribute with this index.
    Opacity(usize),
}

fn arrays(mesh: &dyn MeshSource, count: usize) -> Vec<UsdArray> {
    let (vertices, triangles) = (mesh.vertex_count(), mesh.triangle_count());
    let vectors = |values| UsdArray { kind: VEC3F, length: vertices, width: 12, values };
    let integers = |length, values| UsdArray { kind: INT, length, width: 4, values };
    let mut arrays = vec![
        vectors(UsdValues::Points),
        integers(triangles, UsdValues::CornerCounts),
        integers(3 * triangles, UsdValues::Corners),
        UsdArray { length: 2, ..vectors(UsdValues::Extent) },
    ];
    arrays.extend(mesh.has_normals().then(|| vectors(UsdValues::Normals)));
    let infos = mesh.attributes();
    let colour = colour_attribute(&infos);
    let floats = |length, values| UsdArray { kind: FLOAT, length, width: 4, values };
    for (index, attribute) in infos.iter().enumerate() {
        if colour == Some(index) {
            arrays.push(vectors(UsdValues::Colour(index)));
            let opacity = || floats(vertices, UsdValues::Opacity(index));
            arrays.extend((attribute.components == 4).then(opacity));
            continue;
        }
        let values = UsdValues::Attribute(index);
        let numbers = floats(vertices * attribute.components as u64, values);
        arrays.push(match (attribute.kind, attribute.components) {
            (AttributeKind::Unsigned, _) => UsdArray { kind: UINT, ..numbers },
            (kind, _) if kind.is_whole() => UsdArray { kind: INT, ..numbers },
            (_, 3) => vectors(numbers.values),
            _ => numbers,
        });
    }
    assert_eq!(arrays.len(), count, "an array a property");
    arrays
}

fn tail(
    properties: &[UsdProperty],
    arrays: &[UsdArray],
    offsets: &[u64],
    at: u64,
    up: UpAxis,
) -> (Vec<u8>, u64) {
    let mut tail = FileTail::new(at);
    let children = tail.tokens(&[PRIM]);
    let prim = tail.token(PRIM);
    let up = tail.token(&up.to_string());
    tail.root(&[
        ("defaultPrim", prim),
        ("metersPerUnit", UsdValue::double(1.0)),
        ("upAxis", up),
        ("primChildren", children),
    ]);
    const SCHEME: &str = "subdivisionScheme";
    let names: Vec<_> =
        [SCHEME].into_iter().chain(properties.iter().map(|p| p.name.as_str())).collect();
    let names = tail.tokens(&names);
    let mesh = tail.token("Mesh");
    tail.prim(PRIM, &[("specifier", UsdValue::def()), ("typeName", mesh), ("properties", names)]);
    let (token, none) = (tail.token("token"), tail.token("none"));
    tail.property(
        SCHEME,
        &[("typeName", token), ("variability", UsdValue::uniform()), ("default", none)],
    );
    for ((property, array), &offset) in properties.iter().zip(arrays).zip(offsets) {
        let value = UsdValue::array(array.kind, offset, array.length);
        let mut fields = vec![("typeName", tail.token(property.kind)), ("default", value)];
        fields.push(("timeSamples", tail.sample(value)));
        if let Some(interpolation) = property.interpolation {
            fields.push(("interpolation", tail.token(interpolation)));
        }
        if let Some(size) = property.element_size {
            fields.push(("elementSize", UsdValue::int(size as u32)));
        }
        tail.property(&property.name, &fields);
    }
    tail.finish()
}

impl UsdArray {
    /// Size, in bytes, of the length, the values, and the padding to a multiple of 8.
    fn bytes(&self) -> u64 {
        8 + self.length * self.width + self.padding()
    }

    fn padding(&self) -> u64 {
        (self.length * self.width).wrapping_neg() % 8
    }

    fn write(
        &self,
        out: &mut dyn Write,
        mesh: &dyn MeshSource,
        extent: &Mutex<[[f32; 3]; 2]>,
    ) -> io::Result<()> {
        let extent = || extent.lock().unwrap_or_else(PoisonError::into_inner);
        match self.values {
            UsdValues::Points => write_vertices(out, mesh, |vertices, out| {
                let mut own = *extent();
                for point in vertices.positions.iter().map(|point| point.map(|x| x as f32)) {
                    for (axis, x) in point.into_iter().enumerate() {
                        own[0][axis] = own[0][axis].min(x);
                        own[1][axis] = own[1][axis].max(x);
                    }
                    out.extend(point.map(f32::to_le_bytes).as_flattened());
                }
                let mut all = extent();
                for axis in 0..3 {
                    all[0][axis] = all[0][axis].min(own[0][axis]);
                    all[1][axis] = all[1][axis].max(own[1][axis]);
                }
            }),
            UsdValues::CornerCounts => {
                write_pieces(out, self.length.div_ceil(COUNTS) as usize, |piece, out| {
                    let count = COUNTS.min(self.length - piece as u64 * COUNTS);
                    out.extend(3i32.to_le_bytes().repeat(count as usize));
                    Ok(())
                })
            }
            UsdValues::Corners => write_triangles(out, mesh, |triangles, out| {
                triangles
                    .as_flattened()
                    .iter()
                    .for_each(|&corner| out.extend((corner as i32).to_le_bytes()));
            }),
            UsdValues::Extent => out.write_all(
                extent()
                    .as_flattened()
                    .iter()
                    .map(|x| x.to_le_bytes())
                    .collect::<Vec<_>>()
                    .as_flattened(),
            ),
            UsdValues::Normals => {
                write_floats(out, mesh, |vertices| vertices.normals.as_flattened())
            }
            UsdValues::Attribute(index) => {
                write_floats(out, mesh, |vertices| &vertices.attributes[index])
            }
            UsdValues::Colour(index) => write_shares(out, mesh, index, 0..3),
            UsdValues::Opacity(index) => write_shares(out, mesh, index, 3..4),
        }
    }
}

/// Writes the components `shares` of the colour attribute `index` as f32 from 0 to 1.
fn write_shares(
    out: &mut dyn Write,
    mesh: &dyn MeshSource,
    index: usize,
    shares: Range<usize>,
) -> io::Result<()> {
    let AttributeInfo { components, kind, .. } = mesh.attributes()[index];
    write_vertices(out, mesh, |vertices, out| {
        for colour in vertices.attributes[index].chunks_exact(components) {
            let shares = colour[shares.clone()].iter().map(|&share| kind.share(share));
            shares.for_each(|share| out.extend(share.to_le_bytes()));
        }
    })
}
