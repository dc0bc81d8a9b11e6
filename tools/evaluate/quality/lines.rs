//! Prints tables with a column for each method. Each method meshes the same particles, and the rows
//! show measurements of the meshes.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use meniscus::internals::io::output::read_mesh;
use meniscus::internals::surface::mesh::Mesh;
use rayon::prelude::*;
use tempfile::TempDir;

use super::programs::Method;
use crate::Outcome;
use crate::tables::Table;

/// The extension of particle files that contain sizes.
pub const SIZED: &str = "csv";

/// Positions of particles.
pub type Points = Vec<[f64; 3]>;

/// Particles with spacing 1, or with individual sizes.
pub struct Scene {
    pub points: Points,
    /// The sizes of the particles; `None` if all have size 1.
    pub sizes: Option<Vec<f64>>,
}

impl From<Points> for Scene {
    fn from(points: Points) -> Self {
        Self { points, sizes: None }
    }
}

type Reading = Box<dyn Fn(&[Mesh]) -> Outcome<Vec<String>> + Send + Sync>;

/// Scenes whose surfaces are measured together. They give one or more rows of a table.
pub struct Line {
    pub rows: Vec<String>,
    /// The cell size, in spacings; `None` for the default of each method.
    pub cell: Option<f64>,
    pub scenes: Vec<Scene>,
    pub lost: Lost,
    /// Measures the meshes of all scenes, and returns a text for each row.
    pub read: Reading,
}

/// What the table shows if a method finds no surface in a scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Lost {
    /// All rows show `none`.
    Row,
    /// The scene's mesh counts as empty. The rows show `none` only if all scenes have empty meshes.
    Scene,
}

/// The methods to compare, and a folder for intermediate files.
pub struct Board {
    pub methods: Vec<Method>,
    folder: TempDir,
    files: AtomicUsize,
}

impl Board {
    pub fn new(methods: Vec<Method>) -> Outcome<Self> {
        Ok(Self { methods, folder: TempDir::new()?, files: AtomicUsize::new(0) })
    }

    /// A new file name in the folder for intermediate files.
    pub fn file(&self, extension: &str) -> PathBuf {
        let number = self.files.fetch_add(1, Ordering::Relaxed);
        self.folder.path().join(format!("{number}.{extension}"))
    }

    /// Runs a method on a particle file. Returns `None` if the method finds no surface.
    pub fn mesh(
        &self,
        method: &Method,
        particles: &Path,
        cell: Option<f64>,
    ) -> Outcome<Option<Mesh>> {
        let output = self.file("ply");
        let Some(_) = method.run([particles, &output], cell, 1)? else { return Ok(None) };
        let mesh = read_mesh(&output)?;
        std::fs::remove_file(&output)?;
        Ok((!mesh.triangles.is_empty()).then_some(mesh))
    }

    /// Runs all methods on all scenes of `lines`, and prints a table.
    pub fn table(&self, heading: &str, lines: Vec<Line>) -> Outcome<()> {
        let start = Instant::now();
        let inputs: Vec<Vec<PathBuf>> =
            lines.iter().map(|line| self.inputs(line)).collect::<Outcome<_>>()?;
        let jobs: Vec<(usize, usize)> = (0..lines.len())
            .flat_map(|line| (0..self.methods.len()).map(move |method| (line, method)))
            .collect();
        let texts: Vec<Vec<String>> = jobs
            .par_iter()
            .with_max_len(1)
            .map(|&(line, method)| self.texts(&lines[line], &inputs[line], &self.methods[method]))
            .collect::<Outcome<_>>()?;

        let head: Vec<&str> =
            [""].into_iter().chain(self.methods.iter().map(|method| &*method.name)).collect();
        let mut table = Table::new(&head);
        for (line, texts) in lines.iter().zip(texts.chunks(self.methods.len())) {
            for (row, name) in line.rows.iter().enumerate() {
                table.row(
                    [name.clone()].into_iter().chain(texts.iter().map(|texts| texts[row].clone())),
                );
            }
        }
        table.show(heading);
        eprintln!("{:.0} s: {heading}", start.elapsed().as_secs_f64());
        Ok(())
    }

    fn inputs(&self, line: &Line) -> Outcome<Vec<PathBuf>> {
        let input = |scene: &Scene| match &scene.sizes {
            None => self.input(&scene.points),
            Some(sizes) => self.sized_input(&scene.points, sizes),
        };
        line.scenes.iter().map(input).collect()
    }

    /// Writes particles to a new file, as raw f32 triples.
    pub fn input(&self, particles: &[[f64; 3]]) -> Outcome<PathBuf> {
        let path = self.file("xyz");
        let mut out = BufWriter::new(File::create(&path)?);
        for coordinate in particles.as_flattened() {
            out.write_all(&(*coordinate as f32).to_le_bytes())?;
        }
        out.flush()?;
        Ok(path)
    }

    /// Writes particles with their radii to a new file, as text.
    fn sized_input(&self, particles: &[[f64; 3]], sizes: &[f64]) -> Outcome<PathBuf> {
        let path = self.file(SIZED);
        let mut out = BufWriter::new(File::create(&path)?);
        writeln!(out, "x,y,z,radius")?;
        for ([x, y, z], size) in particles.iter().zip(sizes) {
            writeln!(out, "{},{},{},{}", *x as f32, *y as f32, *z as f32, size / 2.0)?;
        }
        out.flush()?;
        Ok(path)
    }

    fn texts(&self, line: &Line, inputs: &[PathBuf], method: &Method) -> Outcome<Vec<String>> {
        let all = |text: &str| Ok(vec![text.to_owned(); line.rows.len()]);
        if !method.takes_all(&line.scenes) {
            return all("");
        }
        let meshes = inputs.iter().map(|input| self.mesh(method, input, line.cell));
        let meshes = meshes.collect::<Outcome<Vec<Option<Mesh>>>>()?;
        let needed = match line.lost {
            Lost::Row => meshes.len(),
            Lost::Scene => 1,
        };
        if meshes.iter().flatten().count() < needed {
            return all("none");
        }
        let meshes: Vec<Mesh> = meshes.into_iter().map(Option::unwrap_or_default).collect();
        (line.read)(&meshes)
    }
}

/// Describes a cell size, for the name of a row.
pub fn cell_name(cell: Option<f64>) -> String {
    cell.map_or("own cells".into(), |cell| format!("cells {cell}"))
}
