//! Universal Scene Description. Each mesh is written as a binary layer. A stage plays many layers
//! as one animated mesh.
//!
//! A layer contains one frame in the prim `/fluid`. Its values are stored as defaults, for programs
//! that open the layer alone, and as samples at time 0, for value clips. A stage maps each layer to
//! its time, so a layer depends only on its mesh. Velocities are in units of length per second.

mod crate_file;
mod layer;
pub mod stage;

pub use layer::write_mesh;

use std::ops::Range;

use crate::particles::{AttributeInfo, AttributeKind, colour_attribute};

/// Name of the mesh's prim.
const PRIM: &str = "fluid";

/// Namespace of the properties that store attributes.
const PRIMVARS: &str = "primvars:";

/// A property of the mesh with values for every frame.
#[derive(Debug, Clone, PartialEq, Eq)]
struct UsdProperty {
    name: String,
    kind: &'static str,
    /// `vertex` for properties whose interpolation must be specified.
    interpolation: Option<&'static str>,
    values: UsdValues,
}

/// The source of a property's values.
#[derive(Debug, Clone, PartialEq, Eq)]
enum UsdValues {
    Points,
    CornerCounts,
    Corners,
    Extent,
    Normals,
    /// A range of components of the attribute with this index.
    Attribute(usize, Range<usize>),
    /// A range of components of the colour attribute with this index, as numbers from 0 to 1.
    ColourFractions(usize, Range<usize>),
}

/// The properties of a mesh with `attributes`, in the order in which a layer stores them.
///
/// Except for `uint[]`, Blender reads all types that are used here. It does not read `float4[]` or
/// arrays with several elements per vertex, so an attribute that fits none of the types has one
/// property per component.
fn properties(has_normals: bool, attributes: &[AttributeInfo]) -> Vec<UsdProperty> {
    let plain = |name: &str, kind, values| UsdProperty {
        name: name.into(),
        kind,
        interpolation: None,
        values,
    };
    let vertex = |name: &str, kind, values| UsdProperty {
        interpolation: Some("vertex"),
        ..plain(name, kind, values)
    };
    let mut all = vec![
        plain("points", "point3f[]", UsdValues::Points),
        plain("faceVertexCounts", "int[]", UsdValues::CornerCounts),
        plain("faceVertexIndices", "int[]", UsdValues::Corners),
        plain("extent", "float3[]", UsdValues::Extent),
    ];
    all.extend(has_normals.then(|| vertex("normals", "normal3f[]", UsdValues::Normals)));
    let colour = colour_attribute(attributes);
    for (index, attribute) in attributes.iter().enumerate() {
        let AttributeInfo { name, components, kind } = attribute;
        if colour == Some(index) {
            all.push(vertex(
                "primvars:displayColor",
                "color3f[]",
                UsdValues::ColourFractions(index, 0..3),
            ));
            if *components == 4 {
                let alpha = UsdValues::ColourFractions(index, 3..4);
                all.push(vertex("primvars:displayOpacity", "float[]", alpha));
            }
            continue;
        }
        let whole = UsdValues::Attribute(index, 0..*components);
        if attribute.is_velocity() {
            all.push(plain("velocities", "vector3f[]", whole));
            continue;
        }
        let mut add = |name: &str, kind, values| {
            let mut name = format!("{PRIMVARS}{}", identifier(name));
            while all.iter().any(|other| other.name == name) {
                name.push('_');
            }
            all.push(vertex(&name, kind, values));
        };
        let number = match kind {
            AttributeKind::Signed | AttributeKind::Wide => "int[]",
            AttributeKind::Unsigned => "uint[]",
            _ => "float[]",
        };
        match components {
            4 if kind.is_colour() => {
                add(name, "color4f[]", UsdValues::ColourFractions(index, 0..4))
            }
            3 if kind.is_colour() => {
                add(name, "color3f[]", UsdValues::ColourFractions(index, 0..3))
            }
            3 if !kind.is_whole() => add(name, "float3[]", whole),
            2 if !kind.is_whole() => add(name, "float2[]", whole),
            1 => add(name, number, whole),
            _ => (0..*components).for_each(|component| {
                let values = UsdValues::Attribute(index, component..component + 1);
                add(&format!("{name}_{component}"), number, values);
            }),
        }
    }
    all
}

/// The properties that the file renames, each with its expected name and its name in the file. The
/// expected name is the attribute's name, followed by the number of the component if components are
/// stored separately. The velocity and the first colour are left out, because USD prescribes their
/// names.
pub fn renamed(has_normals: bool, attributes: &[AttributeInfo]) -> Vec<[String; 2]> {
    let colour = colour_attribute(attributes);
    let differs = |UsdProperty { name, values, .. }: UsdProperty| {
        let (UsdValues::Attribute(index, range) | UsdValues::ColourFractions(index, range)) =
            values
        else {
            return None;
        };
        let stored = name.strip_prefix(PRIMVARS).filter(|_| colour != Some(index))?;
        let AttributeInfo { name, components, .. } = &attributes[index];
        let expected = match range.len() == *components {
            true => name.clone(),
            false => format!("{name}_{}", range.start),
        };
        (stored != expected).then(|| [expected, stored.to_owned()])
    };
    properties(has_normals, attributes).into_iter().filter_map(differs).collect()
}

/// Number of passes that the writer makes over a mesh: one pass over the triangles, and all others
/// over the vertices.
pub fn pass_count(has_normals: bool, attributes: &[AttributeInfo]) -> usize {
    // `properties` also lists the numbers of corners and the extent, which need no pass.
    properties(has_normals, attributes).len() - 2
}

/// Converts a name to a valid USD identifier: only letters, digits and underscores, and no digit at
/// the start.
fn identifier(name: &str) -> String {
    let plain = name.replace(|c: char| !c.is_ascii_alphanumeric() && c != '_', "_");
    if plain.starts_with(|c: char| c.is_ascii_digit()) || plain.is_empty() {
        format!("_{plain}")
    } else {
        plain
    }
}
