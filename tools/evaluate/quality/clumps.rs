//! Compares methods on sheets and chains next to a bulk, on drops and on bubbles: how much of them
//! the surface keeps, and in how many components.

use glam::{DVec2, DVec3, IVec3};
use meniscus::internals::surface::mesh::Mesh;

use super::bodies::JITTER;
use super::components::{Component, Count, components, handles};
use super::heights::Columns;
use super::lines::{Board, Line, Lost, Points, cell_name};
use crate::sample::{cuboid, unit_cube_point};
use crate::scene::Random;
use crate::tables::mean;
use crate::{Options, Outcome};

/// Cell sizes, in spacings, from fine to coarse.
pub const CELLS: [f64; 4] = [0.25, 0.333, 0.5, 0.667];
/// Vertical distance between sheets above a bulk, in spacings.
const SHEET_DISTANCE: f64 = 12.0;
const SHEETS: [(&str, i32, f64); 4] = [
    ("1 layer", 1, 1.0),
    ("2 layers", 2, 1.0),
    ("1 layer, stretched 1.3 times", 1, 1.3),
    ("2 layers, stretched 1.3 times", 2, 1.3),
];
/// Number of particles along the edges of a sheet.
const WIDTH: i32 = 40;
/// Distances between the particles of a chain, in spacings.
const GAPS: [f64; 3] = [1.0, 1.25, 1.5];
/// Number of chains per gap.
const CHAINS: usize = 6;
/// Distance between chains, in spacings.
const APART: f64 = 8.0;
/// Number of particles in a chain.
const LINKS: usize = 8;
/// Number of drops of each size along each of two axes.
const DROPS: usize = 7;
/// Distance between drops, in spacings.
const STEP: f64 = 10.0;
const SIZES: [IVec3; 3] = [IVec3::ONE, IVec3::new(2, 1, 1), IVec3::splat(2)];
/// Radii of air bubbles, in spacings.
const AIR: [f64; 2] = [2.0, 3.0];
/// Number of air bubbles of each radius.
const BALLS: usize = 4;
/// Number of particles along each edge of the cubes of fluid.
const EDGE: i32 = 24;

pub fn run(options: &Options, board: &Board) -> Outcome<()> {
    let sheet_rows = |(what, ..): (&str, i32, f64)| {
        [format!("{what}: components, holes"), format!("{what}: volume")]
    };
    let sheets = Line {
        rows: SHEETS.into_iter().flat_map(sheet_rows).collect(),
        cell: None,
        scenes: vec![sheets().into()],
        lost: Lost::Row,
        read: Box::new(|meshes| {
            Ok(SHEETS
                .iter()
                .enumerate()
                .flat_map(|(n, sheet)| sheet_texts(&meshes[0], n, sheet))
                .collect())
        }),
    };
    board.table(
        "sheets above a bulk, jittered by 0.3: volume is relative to the particles'",
        vec![sheets],
    )?;

    let chain_rows = |gap: f64| {
        [format!("{gap} apart: components of a chain"), format!("{gap} apart: share covered")]
    };
    let chains = Line {
        rows: GAPS.into_iter().flat_map(chain_rows).collect(),
        cell: None,
        scenes: vec![chains().into()],
        lost: Lost::Row,
        read: Box::new(|meshes| {
            Ok((0..GAPS.len()).flat_map(|gap| chain_texts(&meshes[0], gap)).collect())
        }),
    };
    board.table(
        "chains of 8 single particles that leave a bulk: 1 component means a whole chain, mean of \
         6",
        vec![chains],
    )?;

    let cells: Vec<Option<f64>> =
        options.choose(&CELLS[..], &CELLS[2..3]).iter().copied().map(Some).collect();
    let of_drops = |bulk: bool, cell: Option<f64>| {
        let beside = if bulk { "beside a bulk" } else { "alone" };
        let row =
            |size: IVec3| format!("of {}, {beside}, {}", size.element_product(), cell_name(cell));
        Line {
            rows: SIZES.map(row).into(),
            cell,
            scenes: vec![drops(bulk).into()],
            lost: Lost::Row,
            read: Box::new(|meshes| {
                let (found, _) = components(&meshes[0]);
                Ok((0..SIZES.len()).map(|size| drop_text(&found, size)).collect())
            }),
        }
    };
    let beside = cells.iter().map(|&cell| of_drops(true, cell));
    let lines = [None].map(|cell| of_drops(false, cell)).into_iter().chain(beside).collect();
    board.table(
        "49 drops of 1, 2 and 8 particles: components; least, mean and greatest volume of \
         a drop, relative to its particles'",
        lines,
    )?;

    let air_row = |radius: f64| format!("radius {radius}: kept of {BALLS}, relative volume");
    let air = Line {
        rows: AIR.map(air_row).into(),
        cell: None,
        scenes: vec![air().into()],
        lost: Lost::Row,
        read: Box::new(|meshes| {
            let (found, _) = components(&meshes[0]);
            Ok((0..AIR.len()).map(|radius| air_text(&found, radius)).collect())
        }),
    };
    let disorder = Line {
        rows: ["jittered by 0.5", "uniformly random"]
            .map(|what| format!("{what}: components, bubbles"))
            .into(),
        cell: None,
        scenes: vec![disorder().into()],
        lost: Lost::Row,
        read: Box::new(|meshes| {
            let (found, _) = components(&meshes[0]);
            let half = 1.5 * f64::from(EDGE);
            let [left, right] = [0, 1].map(|side| {
                Count::of(
                    found
                        .iter()
                        .filter(move |component| usize::from(component.centre().x > half) == side),
                )
                .text()
            });
            Ok(vec![left, right])
        }),
    };
    board
        .table("balls of air in a bulk jittered by 0.3, and bulks without air", vec![air, disorder])
}

fn moved(particles: Points, by: DVec3) -> impl Iterator<Item = [f64; 3]> {
    particles.into_iter().map(move |p| (DVec3::from(p) + by).into())
}

fn sheets() -> Points {
    let mut random = Random::new(11);
    let mut particles =
        cuboid(IVec3::new(0, -28, 0), IVec3::new(WIDTH, -16, WIDTH), JITTER, &mut random);
    for (n, (_, layers, stretch)) in SHEETS.into_iter().enumerate() {
        let sheet = cuboid(IVec3::ZERO, IVec3::new(WIDTH, layers, WIDTH), JITTER, &mut random);
        let sheet = sheet.into_iter().map(|[x, y, z]| [stretch * x, y, stretch * z]).collect();
        particles.extend(moved(sheet, unit_cube_point(n) + SHEET_DISTANCE * n as f64 * DVec3::Y));
    }
    particles
}

fn sheet_texts(mesh: &Mesh, number: usize, &(_, layers, _): &(&str, i32, f64)) -> [String; 2] {
    let middle = SHEET_DISTANCE * number as f64 + 1.0;
    let near = |triangle: &&[u32; 3]| {
        triangle.iter().all(|&vertex| {
            (mesh.positions[vertex as usize][1] - middle).abs() < SHEET_DISTANCE / 2.0
        })
    };
    let triangles = mesh.triangles.iter().filter(near).copied().collect();
    let sheet = Mesh { positions: mesh.positions.clone(), triangles, ..Mesh::default() };
    let (found, _) = components(&sheet);
    let volume = Count::of(&found).volume / f64::from(WIDTH * WIDTH * layers);
    if sheet.triangles.is_empty() {
        return [(); 2].map(|()| "lost".into());
    }
    [format!("{}, {}", found.len(), handles(&sheet)), format!("{volume:.2}")]
}

/// The position of a chain's base, on top of the bulk.
fn foot(gap: usize, chain: usize) -> DVec3 {
    let off = unit_cube_point(CHAINS * gap + chain);
    APART * DVec3::new(1.0 + chain as f64, 0.0, 1.0 + gap as f64) + DVec3::new(off.x, -0.5, off.z)
}

fn link(gap: usize, chain: usize, link: usize) -> DVec3 {
    foot(gap, chain) + GAPS[gap] * (link + 1) as f64 * DVec3::Y
}

fn chains() -> Points {
    let size = APART * DVec3::new(1.0 + CHAINS as f64, 0.0, 1.0 + GAPS.len() as f64);
    let bulk = IVec3::new(size.x as i32, 0, size.z as i32);
    let mut particles = cuboid(IVec3::new(0, -12, 0), bulk, 0.1, &mut Random::new(12));
    for gap in 0..GAPS.len() {
        for chain in 0..CHAINS {
            particles.extend((0..LINKS).map(|n| link(gap, chain, n).to_array()));
        }
    }
    particles
}

/// Means over the chains with gap number `gap`: the number of components near a chain and above the
/// bulk, and the share of the chain's particles that are inside the surface.
fn chain_texts(mesh: &Mesh, gap: usize) -> [String; 2] {
    let (found, of_vertices) = components(mesh);
    let of = |chain: usize| {
        let foot = foot(gap, chain);
        let near =
            |p: &[f64; 3]| p[1] > 1.0 && DVec2::new(p[0] - foot.x, p[2] - foot.z).length() < 3.0;
        let mut reaching: Vec<usize> = mesh
            .positions
            .iter()
            .zip(&of_vertices)
            .filter_map(|(p, component)| {
                component.filter(|&component| near(p) && found[component].volume > 0.0)
            })
            .collect();
        reaching.sort_unstable();
        reaching.dedup();

        let at = DVec2::new(foot.x, foot.z);
        let column = Columns::over(at - 0.25, at + 0.25);
        let mut inside = [0; LINKS];
        column.cross(mesh, |_, height, normal| {
            for (n, inside) in inside.iter_mut().enumerate() {
                if height > link(gap, chain, n).y {
                    *inside += if normal.y > 0.0 { 1 } else { -1 };
                }
            }
        });
        let covered = inside.iter().filter(|&&above| above > 0).count() as f64 / LINKS as f64;
        [reaching.len() as f64, covered]
    };
    let of: Vec<[f64; 2]> = (0..CHAINS).map(of).collect();
    [0, 1].map(|n| format!("{:.2}", mean(of.iter().map(|figures| figures[n]))))
}

/// The approximate position of a drop, given the index of its size and the drop's number.
fn drop_place(size: usize, number: usize) -> DVec3 {
    STEP * DVec3::new((number % DROPS) as f64, 1.0 + size as f64, (number / DROPS) as f64)
}

fn drops(bulk: bool) -> Points {
    let mut random = Random::new(13);
    let mut particles = Vec::new();
    if bulk {
        particles = cuboid(IVec3::new(0, -12, 0), IVec3::new(EDGE, 0, EDGE), JITTER, &mut random);
    }
    for (n, size) in SIZES.into_iter().enumerate() {
        for number in 0..DROPS * DROPS {
            let drop = cuboid(IVec3::ZERO, size, JITTER, &mut random);
            particles.extend(moved(drop, drop_place(n, number) + unit_cube_point(number)));
        }
    }
    particles
}

fn drop_text(found: &[Component], size: usize) -> String {
    let count = f64::from(SIZES[size].element_product());
    let near = |component: &&Component, number: usize| {
        (component.centre() - drop_place(size, number)).abs().max_element() < STEP / 2.0
    };
    let of: Vec<Count> = (0..DROPS * DROPS)
        .map(|number| Count::of(found.iter().filter(|component| near(component, number))))
        .collect();
    let kept: usize = of.iter().map(|drop| drop.components).sum();
    let volumes = || of.iter().map(|drop| drop.volume / count);
    let (least, greatest) =
        (volumes().fold(f64::INFINITY, f64::min), volumes().fold(0.0, f64::max));
    format!("{kept}; {least:.2}, {:.2}, {greatest:.2}", mean(volumes()))
}

/// The centre of an air bubble, given the index of its radius and the bubble's number.
fn air_place(radius: usize, ball: usize) -> DVec3 {
    DVec3::new(8.0 + 12.0 * ball as f64, 10.0, 8.0 + 12.0 * radius as f64)
        + unit_cube_point(BALLS * radius + ball)
}

fn air() -> Points {
    let size = IVec3::new(16 + 12 * (BALLS as i32 - 1), 20, 16 + 12 * (AIR.len() as i32 - 1));
    let mut particles = cuboid(IVec3::ZERO, size, JITTER, &mut Random::new(14));
    for (n, radius) in AIR.into_iter().enumerate() {
        for ball in 0..BALLS {
            particles.retain(|&p| DVec3::from(p).distance(air_place(n, ball)) > radius);
        }
    }
    particles
}

fn air_text(found: &[Component], radius: usize) -> String {
    let of = (0..BALLS).map(|ball| {
        let near = |component: &&Component| {
            component.volume < 0.0
                && component.centre().distance(air_place(radius, ball)) < AIR[radius]
        };
        -Count::of(found.iter().filter(near)).volume
    });
    let volumes: Vec<f64> = of.collect();
    let truth = 4.0 / 3.0 * std::f64::consts::PI * AIR[radius].powi(3);
    let kept = volumes.iter().filter(|&&volume| volume > 0.0).count();
    format!("{kept}, {:.2}", mean(volumes.iter().map(|volume| volume / truth)))
}

/// Two bulks side by side: one strongly jittered, one with random positions.
fn disorder() -> Points {
    let mut random = Random::new(15);
    let mut particles = cuboid(IVec3::ZERO, IVec3::splat(EDGE), 0.5, &mut random);
    let edge = f64::from(EDGE);
    particles.extend((0..EDGE.pow(3)).map(|_| {
        let [x, y, z] = [(); 3].map(|()| edge * random.unit());
        [2.0 * edge + x, y, z]
    }));
    particles
}
