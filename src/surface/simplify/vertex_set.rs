//! A set of a mesh's vertices, a bit each, that knows how many come before each of its members.

/// Words that are counted together.
const RUN: usize = 8;

/// Vertices by their numbers.
#[derive(Debug)]
pub struct VertexSet {
    words: Vec<u64>,
    /// Members before each run of words, once counted.
    before: Vec<u64>,
}

impl VertexSet {
    /// None of so many.
    pub fn none_of(vertices: u64) -> Self {
        Self { words: vec![0; vertices.div_ceil(64) as usize], before: Vec::new() }
    }

    /// Adds one.
    pub fn insert(&mut self, vertex: u64) {
        self.words[(vertex / 64) as usize] |= 1 << (vertex % 64);
    }

    /// Whether it is a member.
    pub fn contains(&self, vertex: u64) -> bool {
        self.words[(vertex / 64) as usize] >> (vertex % 64) & 1 == 1
    }

    /// Counts the members, from now on to be asked for their ranks.
    pub fn count(&mut self) {
        let mut total = 0;
        self.before = self
            .words
            .chunks(RUN)
            .map(|run| {
                let before = total;
                total += run.iter().map(|word| u64::from(word.count_ones())).sum::<u64>();
                before
            })
            .collect();
        self.before.push(total);
    }

    /// How many members have lesser numbers.
    pub fn rank(&self, vertex: u64) -> u64 {
        let word = (vertex / 64) as usize;
        let run = word / RUN;
        let whole: u64 = self.words[run * RUN..word].iter().map(|word| u64::from(word.count_ones())).sum();
        let part = self.words.get(word).map_or(0, |word| word & ((1 << (vertex % 64)) - 1));
        self.before[run] + whole + u64::from(part.count_ones())
    }
}
