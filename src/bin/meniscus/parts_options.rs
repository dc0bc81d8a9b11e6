//! Options on one frame's mesh in parts.

use clap::{Args, value_parser};
use meniscus::Error;

#[derive(Args)]
pub struct PartsOptions {
    /// Make one frame's mesh in N parts, on any machines: with --plan, then --part I for each, then --merge.
    ///
    /// All have to be asked for the same. Plan and parts are kept beside the output, in a folder named as it with .meniscus-parts
    /// appended.
    #[arg(long, value_name = "N", value_parser = value_parser!(u32).range(1..), help_heading = "Clusters", hide_short_help = true)]
    pub parts: Option<u32>,
    /// Make part I of them, from 0. Any order will do; what is killed can be begun again.
    #[arg(
        long,
        value_name = "I",
        requires = "parts",
        conflicts_with_all = ["plan", "merge"],
        help_heading = "Clusters",
        hide_short_help = true
    )]
    part: Option<u32>,
    /// Check all parts, and write the mesh: byte for byte that of a single run.
    #[arg(
        long,
        requires = "parts",
        conflicts_with = "plan",
        help_heading = "Clusters",
        hide_short_help = true
    )]
    merge: bool,
}

/// A step on the way to a mesh in parts.
pub enum Step {
    Plan,
    Part(u32),
    Merge,
}

impl PartsOptions {
    /// The one step that is asked for, by whether it is the plan.
    pub fn step(&self, plan: bool) -> Result<Step, Error> {
        match (plan, self.part, self.merge) {
            (true, ..) => Ok(Step::Plan),
            (false, Some(part), _) => Ok(Step::Part(part)),
            (false, None, true) => Ok(Step::Merge),
            (false, None, false) => Err(Error::Request("--parts needs --plan, --part I or --merge".into())),
        }
    }
}
