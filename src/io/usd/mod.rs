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

use crate::particles::{AttributeInfo, AttributeKind, colour_attribute};

/// Name of the mesh's prim.
const PRIM: &str = "fluid";

/// A property of the mesh with values for every frame.
#[derive(Debug, Clone, PartialEq, Eq)]
struct UsdProperty {
    name: String,
    kind: &'static str,
    /// `vertex` for properties whose interpolation must be specified.
    interpolation: Option<&'static str>,
    /// Number of values per vertex. `None` if the type implies it.
    element_size: Option<usize>,
}

/// The properties of a mesh with `attributes`, in the order in which a layer stores them.
fn properties(has_normals: bool, attributes: &[AttributeInfo]) -> Vec<UsdProperty> {
    let plain = |name: &str, kind| UsdProperty {
        name: name.into(),
        kind,
        interpolation: None,
        element_size: None,
    };
    let mut all = vec![
        plain("points", "point3f[]"),
        plain("faceVertexCounts", "int[]"),
        plain("faceVertexIndices", "int[]"),
        plain("extent", "float3[]"),
    ];
    if has_normals {
        all.push(UsdProperty { interpolation: Some("vertex"), ..plain("normals", "normal3f[]") });
    }
    let colour = colour_attribute(attributes);
    for (index, attribute) in attributes.iter().enumerate() {
        if colour == Some(index) {
            let vertex =
                |name, kind| UsdProperty { interpolation: Some("vertex"), ..plain(name, kind) };
            all.push(vertex("primvars:displayColor", "color3f[]"));
            if attribute.components == 4 {
                all.push(vertex("primvars:displayOpacity", "float[]"));
            }
            continue;
        }
        if attribute.is_velocity() {
            all.push(plain("velocities", "vector3f[]"));
            continue;
        }
        let AttributeInfo { name, components, .. } = attribute;
        let mut name = format!("primvars:{}", identifier(name));
        while all.iter().any(|other| other.name == name) {
            name.push('_');
        }
        let kind = match attribute.kind {
            AttributeKind::Signed | AttributeKind::Wide => "int[]",
            AttributeKind::Unsigned => "uint[]",
            _ if *components == 3 => "float3[]",
            _ => "float[]",
        };
        let says = *components == 1 || kind == "float3[]";
        let element_size = Some(*components).filter(|_| !says);
        all.push(UsdProperty { name, kind, interpolation: Some("vertex"), element_size });
    }
    all
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
