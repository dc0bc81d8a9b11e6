//! The Python classes `Report` and `Check`, which describe a mesh.

use std::collections::BTreeMap;

use meniscus::SpacingSource;
use meniscus::mesh::{CheckReport, Measures};
use pyo3::prelude::*;

/// Facts about the reconstruction of a surface. Lengths are in the unit of the positions.
///
/// Attributes
/// ----------
/// spacing : float or None
///     Distance between neighbouring particles; None if it is unknown because the caller chose a
///     cell size.
/// spacing_source : str or None
///     Source of the spacing, as text; None for packed frames and for frames of a simulation.
/// cell_size : float
///     Edge of a cell.
/// origin : tuple of three floats
///     The origin of the grid, which is a corner of a cell.
/// indicator : str or None
///     The indicator that computed the field; None for kernel methods.
/// smooth, sigma, iso : float or None
///     Smoothing width in spacings, standard deviation of the Gaussian in cells, and isovalue; None
///     if they do not apply.
/// particles : int
///     Number of particles that were used.
/// not_finite, too_far, outside : int
///     Number of particles that were skipped because a coordinate is not finite, because they are
///     too far from the grid's origin, or because they are outside the domain or the periodic box.
/// wrapped : int
///     Number of particles that were at most one spacing outside the periodic box, and were moved
///     into it by one period. ``particles`` includes them.
/// lost : int
///     Lower bound on the number of particles outside the surface.
/// too_small : int
///     Number of drops and bubbles that were removed because they are too small.
/// whole_triangles : int
///     Number of triangles before the mesh was simplified and small components were removed.
/// backend : str
///     The CPU, or the name of the device.
/// threads : int
///     Number of threads.
/// seconds : dict
///     Time, in seconds, of each stage.
/// warnings : list of str
///     Warnings about the surface, which were also issued as ``meniscus.MeshWarning``.
#[pyclass(frozen, get_all, module = "meniscus")]
pub struct Report {
    spacing: Option<f64>,
    spacing_source: Option<String>,
    cell_size: f64,
    origin: (f64, f64, f64),
    indicator: Option<&'static str>,
    smooth: Option<f64>,
    sigma: Option<f64>,
    iso: Option<f64>,
    particles: usize,
    not_finite: usize,
    too_far: usize,
    outside: usize,
    wrapped: usize,
    lost: u64,
    too_small: u64,
    whole_triangles: u64,
    backend: String,
    threads: usize,
    seconds: BTreeMap<&'static str, f64>,
    warnings: Vec<String>,
}

impl From<&meniscus::Report> for Report {
    fn from(found: &meniscus::Report) -> Self {
        let source = found.cells.as_ref().and_then(|cells| cells.spacing.as_ref());
        let census = found.facts.census;
        let mut seconds = BTreeMap::new();
        found
            .timings
            .seconds()
            .iter()
            .for_each(|(stage, took)| *seconds.entry(*stage).or_default() += took);
        Self {
            spacing: found.facts.spacing,
            spacing_source: source.map(|(_, source): &(f64, SpacingSource)| source.to_string()),
            cell_size: found.facts.grid.cell_size(),
            origin: found.facts.grid.origin().into(),
            indicator: found.indicator.map(|indicator| indicator.kind().name()),
            smooth: found.smooth,
            sigma: found.sigma,
            iso: found.isovalue(),
            particles: census.binned,
            not_finite: census.not_finite,
            too_far: census.too_far,
            outside: census.outside,
            wrapped: census.wrapped,
            lost: found.lost,
            too_small: found.too_small.map_or(0, |small| small.total()),
            whole_triangles: found.whole_triangles,
            backend: found.backend.clone(),
            threads: found.threads,
            seconds,
            warnings: found.warnings.iter().map(ToString::to_string).collect(),
        }
    }
}

#[pymethods]
impl Report {
    fn __repr__(&self) -> String {
        let Self { particles, cell_size, warnings, .. } = self;
        format!(
            "<meniscus.Report: {particles} particles, cells of {cell_size}, {} warnings>",
            warnings.len()
        )
    }
}

/// The result of ``Mesh.check``: defects and measures of a mesh. It is True as a condition if the
/// mesh is closed, oriented and 2-manifold, and all positions are finite.
///
/// Attributes
/// ----------
/// closed, oriented, manifold : bool
///     Closed: no edge belongs to only one triangle. Oriented: the two triangles of an edge
///     traverse it in opposite directions. Manifold: no edge belongs to more than two triangles,
///     and the triangles around each vertex form a single fan.
/// boundary_edges, misoriented_edges, crowded_edges, pinched_vertices, degenerate_triangles,
/// non_finite_positions : int
///     Number of occurrences of each defect.
/// vertices, triangles, components : int
///     Number of vertices, triangles and connected components; components share no vertex.
/// euler_characteristic : int
///     Vertices - edges + triangles.
/// genus : int or None
///     Total number of topological handles of all components; None unless the mesh is closed,
///     oriented and 2-manifold.
/// area : float
///     Total area of all triangles, in squared units of length.
/// volume : float or None
///     Enclosed volume, in cubed units of length; None unless the mesh is closed and oriented.
#[pyclass(frozen, get_all, module = "meniscus")]
pub struct Check {
    closed: bool,
    oriented: bool,
    manifold: bool,
    boundary_edges: usize,
    misoriented_edges: usize,
    crowded_edges: usize,
    pinched_vertices: usize,
    degenerate_triangles: usize,
    non_finite_positions: usize,
    vertices: usize,
    triangles: usize,
    components: usize,
    euler_characteristic: i64,
    genus: Option<i64>,
    area: f64,
    volume: Option<f64>,
}

impl Check {
    pub fn of(found: &CheckReport, measures: &Measures) -> Self {
        let topology = &found.topology;
        Self {
            closed: topology.is_closed(),
            oriented: topology.is_oriented(),
            manifold: topology.is_manifold(),
            boundary_edges: topology.boundary_edges.count,
            misoriented_edges: topology.misoriented_edges.count,
            crowded_edges: topology.crowded_edges.count,
            pinched_vertices: topology.pinched_vertices.count,
            degenerate_triangles: topology.degenerate_triangles.count,
            non_finite_positions: found.non_finite_positions.count,
            vertices: found.vertices,
            triangles: found.triangles,
            components: measures.components,
            euler_characteristic: measures.euler_characteristic,
            genus: measures.genus,
            area: measures.area,
            volume: measures.volume,
        }
    }
}

#[pymethods]
impl Check {
    fn __bool__(&self) -> bool {
        self.closed && self.oriented && self.manifold && self.non_finite_positions == 0
    }

    fn __repr__(&self) -> String {
        let no = |is: bool| if is { "" } else { "not " };
        format!(
            "<meniscus.Check: {}closed, {}oriented, {}manifold, {} components>",
            no(self.closed),
            no(self.oriented),
            no(self.manifold),
            self.components
        )
    }
}
