//! Structures that describe how a mesh was reconstructed, and structures with the defects and
//! measures of a mesh.

use meniscus::mesh::{CheckReport, Measures};
use meniscus::{Report, SpacingSource};

use crate::sized::SizedStruct;

/// The source of a frame's spacing.
#[repr(i32)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MeniscusSpacingSource {
    /// Unknown: the frame was packed, or belongs to a simulation.
    Unknown = 0,
    /// The options specify the spacing.
    Given = 1,
    /// The particle file contains the spacing.
    File = 2,
    /// A scene file next to the particle file contains the spacing.
    Scene = 3,
    /// The library estimated the spacing from the particles.
    Estimated = 4,
    /// The spacing is the smallest size in an attribute of the particles.
    Sizes = 5,
}

/// Facts about the reconstruction of a mesh. The caller sets `size`, and the library sets the other
/// fields. Lengths are in the unit of the positions.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct MeniscusReport {
    /// sizeof(MeniscusReport).
    pub size: usize,
    /// Distance between neighbouring particles; 0 if unknown.
    pub spacing: f64,
    /// Edge of a cell.
    pub cell_size: f64,
    /// The origin of the grid, which is a corner of a cell.
    pub origin: [f64; 3],
    /// Smoothing width, in spacings, for the indicator "cloud"; 0 otherwise.
    pub smooth: f64,
    /// Standard deviation, in cells, of the Gaussian for the indicators "counting" and "symmetry";
    /// 0 otherwise.
    pub sigma: f64,
    /// The isovalue; 0 if the surface has none.
    pub isovalue: f64,
    /// Total time, in seconds, of all stages except writing.
    pub seconds: f64,
    /// Number of particles that were used.
    pub particles: u64,
    /// Number of particles that were skipped because a coordinate is not finite.
    pub not_finite: u64,
    /// Number of particles that were skipped because they are too far from the grid's origin.
    pub too_far: u64,
    /// Number of particles that were left out because they are outside the domain or the periodic
    /// box.
    pub outside: u64,
    /// Lower bound on the number of particles outside the surface.
    pub lost: u64,
    /// Number of components that the option "smallest-component" removed.
    pub small_components: u64,
    /// Number of drops that the option "smallest-drop" removed.
    pub small_drops: u64,
    /// Number of triangles before the mesh was simplified and components were removed.
    pub whole_triangles: u64,
    /// Number of threads.
    pub threads: u32,
    /// One of MeniscusSpacingSource.
    pub spacing_source: i32,
    /// Number of particles that were at most one spacing outside the periodic box, and were moved
    /// into it by one period. They are among the particles that were used.
    pub wrapped: u64,
}

// SAFETY: all fields are numbers.
unsafe impl SizedStruct for MeniscusReport {
    const NAME: &str = "MeniscusReport";
}

impl From<&Report> for MeniscusReport {
    fn from(report: &Report) -> Self {
        let (facts, census) = (&report.facts, report.facts.census);
        let source = report.cells.as_ref().and_then(|cells| cells.spacing.as_ref());
        let too_small = report.too_small.unwrap_or_default();
        Self {
            size: size_of::<Self>(),
            spacing: facts.spacing.unwrap_or_default(),
            cell_size: facts.grid.cell_size(),
            origin: facts.grid.origin().to_array(),
            smooth: report.smooth.unwrap_or_default(),
            sigma: report.sigma.unwrap_or_default(),
            isovalue: report.isovalue().unwrap_or_default(),
            seconds: report.timings.total(),
            particles: census.binned as u64,
            not_finite: census.not_finite as u64,
            too_far: census.too_far as u64,
            outside: census.outside as u64,
            lost: report.lost,
            small_components: too_small.components,
            small_drops: too_small.drops,
            whole_triangles: report.whole_triangles,
            threads: u32::try_from(report.threads).unwrap_or(u32::MAX),
            spacing_source: source.map_or(
                MeniscusSpacingSource::Unknown,
                |(_, source)| match source {
                    SpacingSource::Given => MeniscusSpacingSource::Given,
                    SpacingSource::File | SpacingSource::State | SpacingSource::Packed => {
                        MeniscusSpacingSource::File
                    }
                    SpacingSource::Scene(_) => MeniscusSpacingSource::Scene,
                    SpacingSource::Sizes(_) => MeniscusSpacingSource::Sizes,
                    SpacingSource::Estimated => MeniscusSpacingSource::Estimated,
                },
            ) as i32,
            wrapped: census.wrapped as u64,
        }
    }
}

/// Defects and measures of a mesh, as `meniscus check` finds them. The caller sets `size`, and the
/// library sets the other fields.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct MeniscusCheck {
    /// sizeof(MeniscusCheck).
    pub size: usize,
    /// The total area of all triangles, in squared units of the positions.
    pub area: f64,
    /// The enclosed volume, in cubed units of the positions; NaN unless the mesh is closed and
    /// oriented.
    pub volume: f64,
    /// The lowest corner of the bounding box of the vertices; 0 for an empty mesh.
    pub lowest: [f64; 3],
    /// The highest corner of the bounding box of the vertices; 0 for an empty mesh.
    pub highest: [f64; 3],
    /// Number of connected components.
    pub components: u64,
    /// Total number of topological handles of all components; -1 unless the mesh is closed,
    /// oriented and 2-manifold.
    pub genus: i64,
    /// Number of edges that belong to only one triangle.
    pub boundary_edges: u64,
    /// Number of edges that both of their triangles traverse in the same direction.
    pub misoriented_edges: u64,
    /// Number of edges that belong to more than two triangles.
    pub crowded_edges: u64,
    /// Number of vertices whose triangles form more than one fan.
    pub pinched_vertices: u64,
    /// Number of triangles with a repeated vertex.
    pub degenerate_triangles: u64,
    /// Number of vertices with a coordinate that is NaN or infinite.
    pub non_finite_vertices: u64,
    /// 1 if the mesh is closed, oriented and 2-manifold, and all positions are finite; else 0.
    pub is_closed_oriented_manifold: i32,
    /// Always 0.
    pub reserved: i32,
}

// SAFETY: all fields are numbers.
unsafe impl SizedStruct for MeniscusCheck {
    const NAME: &str = "MeniscusCheck";
}

impl MeniscusCheck {
    pub fn new(found: &CheckReport, measures: &Measures) -> Self {
        let [lowest, highest] = measures.bounds.unwrap_or_default();
        let topology = &found.topology;
        Self {
            size: size_of::<Self>(),
            area: measures.area,
            volume: measures.volume.unwrap_or(f64::NAN),
            lowest,
            highest,
            components: measures.components as u64,
            genus: measures.genus.unwrap_or(-1),
            boundary_edges: topology.boundary_edges.count as u64,
            misoriented_edges: topology.misoriented_edges.count as u64,
            crowded_edges: topology.crowded_edges.count as u64,
            pinched_vertices: topology.pinched_vertices.count as u64,
            degenerate_triangles: topology.degenerate_triangles.count as u64,
            non_finite_vertices: found.non_finite_positions.count as u64,
            is_closed_oriented_manifold: found.is_closed_oriented_manifold().into(),
            reserved: 0,
        }
    }
}
