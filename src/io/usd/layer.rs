//! Writes one frame as a binary layer.

use std::io::{self, Write};
use std::ops::Range;
use std::sync::{Mutex, PoisonError};

use crate::io::UpAxis;
use crate::io::encode::{write_floats, write_pieces, write_triangles, write_vertices};
use crate::particles::{AttributeInfo, AttributeKind};
use crate::surface::mesh::source::MeshSource;

use super::crate_file::{
    FLOAT, FileTail, HEADER, INT, UINT, UsdValue, VEC2F, VEC3F, VEC4F, header,
};
use super::{PRIM, UsdProperty, UsdValues, properties};

/// Number of triangles whose corner counts are encoded at once.
const COUNTS: u64 = 1 << 16;

/// Writes `mesh` as a .usdc layer.
///
/// Points are written as f32, as the schema requires. An attribute `velocity` of three components
/// is written as `velocities`, the first colour as `primvars:displayColor`, and its alpha as
/// `primvars:displayOpacity`. Other attributes become `primvars` under their own names, in which
/// underscores replace invalid characters. Colours range from 0 to 1.
///
/// The layer declares the up axis, and no data is rotated. The unit is 1 m, because the actual unit
/// is unknown.
///
/// # Panics
/// Like [`MeshFormat::write`](crate::io::output::MeshFormat::write).
pub fn write_mesh(out: &mut dyn Write, mesh: &dyn MeshSource, up: UpAxis) -> io::Result<()> {
    let properties = properties(mesh.has_normals(), &mesh.attributes());
    let arrays: Vec<_> = properties.iter().map(|property| UsdArray::of(property, mesh)).collect();
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

/// The array with the values of a property.
struct UsdArray<'a> {
    values: &'a UsdValues,
    kind: u64,
    length: u64,
    /// Size of an element in bytes.
    width: u64,
}

impl<'a> UsdArray<'a> {
    fn of(property: &'a UsdProperty, mesh: &dyn MeshSource) -> Self {
        let (kind, width) = match property.kind {
            "int[]" => (INT, 4),
            "uint[]" => (UINT, 4),
            "float[]" => (FLOAT, 4),
            "float2[]" => (VEC2F, 8),
            "color4f[]" => (VEC4F, 16),
            _ => (VEC3F, 12),
        };
        let length = match property.values {
            UsdValues::CornerCounts => mesh.triangle_count(),
            UsdValues::Corners => 3 * mesh.triangle_count(),
            UsdValues::Extent => 2,
            _ => mesh.vertex_count(),
        };
        Self { values: &property.values, kind, length, width }
    }
}

fn tail(
    properties: &[UsdProperty],
    arrays: &[UsdArray<'_>],
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
        tail.property(&property.name, &fields);
    }
    tail.finish()
}

impl UsdArray<'_> {
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
        match *self.values {
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
            UsdValues::Attribute(index, ref components) => {
                write_components(out, mesh, index, components, |_, number| number)
            }
            UsdValues::ColourFractions(index, ref components) => {
                write_components(out, mesh, index, components, AttributeKind::share)
            }
        }
    }
}

/// Writes the wanted `components` of the attribute `index`, each converted by `number`.
fn write_components(
    out: &mut dyn Write,
    mesh: &dyn MeshSource,
    index: usize,
    components: &Range<usize>,
    number: fn(AttributeKind, f32) -> f32,
) -> io::Result<()> {
    let AttributeInfo { components: stride, kind, .. } = mesh.attributes()[index];
    write_vertices(out, mesh, |vertices, out| {
        for values in vertices.attributes[index].chunks_exact(stride) {
            let values = values[components.clone()].iter();
            values.for_each(|&value| out.extend(number(kind, value).to_le_bytes()));
        }
    })
}
