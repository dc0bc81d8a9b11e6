//! A seeded scene of any size, in units of the particle spacing: a pool with waves, a falling
//! sphere, a thin sheet and spray. The particles are on a jittered lattice, in random order or in
//! the order of a simulation.

/// A small pseudo-random number generator with the same numbers on every machine (splitmix64).
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// A number in [0, 1).
    pub fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1_u64 << 53) as f64
    }
}

/// About `count` particles at spacing 1, in random order.
pub fn splash(count: usize, seed: u64) -> Vec<[f32; 3]> {
    let mut random = Random::new(seed);
    let mut particles = splash_in_rows(count, &mut random);
    for i in (1..particles.len()).rev() {
        particles.swap(i, (random.bits() % (i as u64 + 1)) as usize);
    }
    particles
}

/// About `count` particles at spacing 1, in the order of a simulation that sorts them by the cells
/// of its neighbour search: in rows of cells, with the spray at the end.
pub fn splash_in_rows(count: usize, random: &mut Random) -> Vec<[f32; 3]> {
    // The pool is four times as wide as it is deep, and holds 96 % of the particles.
    let depth = (count as f64 * 0.96 / 16.0).cbrt();
    let width = 4.0 * depth;
    let radius = 0.25 * depth;
    let sphere = [0.5 * width, 1.7 * depth, 0.5 * width];
    let surface = |x: f64, z: f64| {
        let tau = std::f64::consts::TAU;
        depth + 0.1 * depth * (3.0 * tau * x / width).sin() * (2.0 * tau * z / width).cos()
    };
    let mut particles = Vec::with_capacity(count + count / 16);
    let top = (sphere[1] + radius).ceil() as i64;
    let side = width as i64;
    for z in 0..side {
        for y in 0..top {
            for x in 0..side {
                let p = [x, y, z].map(|c| c as f64 + 0.5);
                let to_sphere: f64 = p.iter().zip(sphere).map(|(a, b)| (a - b).powi(2)).sum();
                let in_sheet = (y - (1.35 * depth) as i64).abs() <= 1 && p[0] < 0.3 * width;
                if p[1] < surface(p[0], p[2]) || to_sphere < radius * radius || in_sheet {
                    particles.push(p.map(|c| (c + 0.6 * (random.unit() - 0.5)) as f32));
                }
            }
        }
    }
    for _ in 0..count / 200 {
        let up = depth * (1.1 + random.unit());
        particles.push([random.unit() * width, up, random.unit() * width].map(|c| c as f32));
    }
    particles
}
