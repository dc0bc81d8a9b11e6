//! Numbers in the caller's structures that stand for one of a few names: any number may be there.

use crate::status::{Failure, Outcome};

/// An enumeration of C.
pub trait Coded: Copy + 'static {
    /// The name in C.
    const NAME: &str;
    /// All that there are, each with its number.
    const ALL: &[(i32, Self)];
}

/// The name that a number stands for.
pub fn coded<T: Coded>(number: i32, what: &str) -> Outcome<T> {
    let found = T::ALL.iter().find(|(code, _)| *code == number);
    found
        .map(|&(_, name)| name)
        .ok_or_else(|| Failure::request(format!("{what} is {number}, which is no {}", T::NAME)))
}

/// Lists the names of an enumeration.
macro_rules! codes {
    ($name:ident: $($variant:ident),+) => {
        impl $crate::coded::Coded for $name {
            const NAME: &str = stringify!($name);
            const ALL: &[(i32, Self)] = &[$((Self::$variant as i32, Self::$variant)),+];
        }
    };
}
pub(crate) use codes;
