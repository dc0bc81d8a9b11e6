//! The connected components of a mesh, and their volumes.

use glam::DVec3;
use meniscus::internals::surface::mesh::Mesh;
use meniscus::internals::surface::mesh::measure::measure;
use petgraph::unionfind::UnionFind;

/// A connected component: triangles that are connected through shared vertices.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Component {
    /// The enclosed volume; negative for a bubble, whose triangles face inwards.
    pub volume: f64,
    pub lo: DVec3,
    pub hi: DVec3,
}

impl Component {
    pub fn centre(&self) -> DVec3 {
        (self.lo + self.hi) / 2.0
    }
}

/// Finds the components, and the index of each vertex's component; `None` for unused vertices.
pub fn components(mesh: &Mesh) -> (Vec<Component>, Vec<Option<usize>>) {
    let mut joined = UnionFind::<u32>::new(mesh.positions.len());
    for &[a, b, c] in &mesh.triangles {
        joined.union(a, b);
        joined.union(a, c);
    }
    let roots = joined.into_labeling();
    let mut numbers = vec![None; mesh.positions.len()];
    let mut components = Vec::new();
    for triangle in &mesh.triangles {
        let number = *numbers[roots[triangle[0] as usize] as usize].get_or_insert_with(|| {
            components.push(Component {
                volume: 0.0,
                lo: DVec3::INFINITY,
                hi: DVec3::NEG_INFINITY,
            });
            components.len() - 1
        });
        let component: &mut Component = &mut components[number];
        // Sum volumes relative to a vertex of the component, which is more precise.
        let origin = DVec3::from(mesh.positions[roots[triangle[0] as usize] as usize]);
        let [a, b, c] = triangle.map(|vertex| DVec3::from(mesh.positions[vertex as usize]));
        component.volume += (a - origin).dot((b - origin).cross(c - origin)) / 6.0;
        component.lo = component.lo.min(a).min(b).min(c);
        component.hi = component.hi.max(a).max(b).max(c);
    }
    let of_vertices = roots.iter().map(|&root| numbers[root as usize]).collect();
    (components, of_vertices)
}

/// The number of handles of all components. A hole through a sheet is a handle.
pub fn handles(mesh: &Mesh) -> i64 {
    let measures = measure(mesh);
    measures.components as i64 - measures.euler_characteristic.div_euclid(2)
}

/// The number of pieces, the number of bubbles, and the volume of a mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Count {
    pub components: usize,
    pub bubbles: usize,
    pub volume: f64,
}

impl Count {
    pub fn of<'a>(components: impl IntoIterator<Item = &'a Component>) -> Self {
        let none = Self { components: 0, bubbles: 0, volume: 0.0 };
        components.into_iter().fold(none, |count, component| {
            let bubble = usize::from(component.volume < 0.0);
            Self {
                components: count.components + 1 - bubble,
                bubbles: count.bubbles + bubble,
                volume: count.volume + component.volume,
            }
        })
    }

    pub fn text(&self) -> String {
        format!("{}, {}", self.components, self.bubbles)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::meshes::{cuboid, moved, union};

    #[test]
    fn bubbles_are_counted_separately_from_components() {
        let mut bubble = cuboid([1.0; 3], [2.0; 3]);
        bubble.triangles.iter_mut().for_each(|triangle| triangle.swap(0, 1));
        let hollow = union(&cuboid([0.0; 3], [3.0; 3]), &bubble);
        let mesh = union(&hollow, &moved(&cuboid([0.0; 3], [1.0; 3]), [7.0, 0.0, 0.0]));
        let (found, of_vertices) = components(&mesh);
        let volumes: Vec<f64> = found.iter().map(|component| component.volume.round()).collect();
        assert_eq!(volumes, [27.0, -1.0, 1.0]);
        assert_eq!(found[2].centre(), DVec3::new(7.5, 0.5, 0.5));
        assert_eq!([of_vertices[0], of_vertices[8], of_vertices[16]], [Some(0), Some(1), Some(2)]);
        let count = Count::of(&found);
        assert_eq!((count.text().as_str(), count.volume.round()), ("2, 1", 27.0));
    }
}
