//! `--method`: frames by discrete indicator functions, or by one of the kernel methods that the paper compares against.

use clap::ValueEnum;
use serde::Serialize;

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum MethodName {
    /// Discrete indicator functions.
    Dif,
    /// Mueller, Charypar and Gross 2003.
    Mueller,
    /// Zhu and Bridson 2005.
    ZhuBridson,
    /// Yu and Turk 2013.
    YuTurk,
}
