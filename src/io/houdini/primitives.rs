//! The primitives of a geometry, whose points are not particles.

use std::fmt;

use serde::Serialize;

/// Whether the file gives polygons this name. Single polygons and listed polygons can be open.
pub(super) fn is_polygon(stored: &str) -> bool {
    matches!(stored, "Poly" | "p_r" | "Polygon_run")
}

/// Whether the file gives runs of open polygons this name.
fn is_polygon_curve(stored: &str) -> bool {
    matches!(stored, "c_r" | "PolygonCurve_run")
}

/// Whether the file gives curves that are not polygons this name.
pub(super) fn is_smooth_curve(stored: &str) -> bool {
    matches!(stored, "NURBCurve" | "BezierCurve")
}

/// Whether primitives with this name in the file are polygons, or curves, which have no surface.
pub(super) fn is_polygon_or_curve(stored: &str) -> bool {
    is_polygon(stored) || is_polygon_curve(stored) || is_smooth_curve(stored)
}

/// Polygons, volumes and other primitives in a Houdini geometry, and the points that they use.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Primitives {
    /// The singular name of each kind of primitive, such as `polygon`, and the number of
    /// primitives.
    pub kinds: Vec<(String, u64)>,
    /// Number of points that the primitives use.
    pub points: u64,
}

impl Primitives {
    /// Combines the kinds of primitives, under the names that the file uses, with the number of
    /// points that the primitives use.
    pub(super) fn new<'a>(stored: impl Iterator<Item = (&'a str, u64)>, points: u64) -> Self {
        let mut kinds: Vec<(String, u64)> = Vec::new();
        for (stored, count) in stored {
            let kind = match stored {
                polygon if is_polygon(polygon) => "polygon".to_owned(),
                curve if is_polygon_curve(curve) => "curve".to_owned(),
                "Volume" => "volume".to_owned(),
                "VDB" => "VDB volume".to_owned(),
                other => format!("{other} primitive"),
            };
            match kinds.iter_mut().find(|(known, _)| *known == kind) {
                Some((_, sum)) => *sum = sum.saturating_add(count),
                None => kinds.push((kind, count)),
            }
        }
        Self { kinds, points }
    }

    /// The number of primitives of each kind, for a message.
    pub(super) fn counted(&self) -> String {
        let counted = |(kind, count): &(String, u64)| {
            format!("{count} {kind}{}", if *count == 1 { "" } else { "s" })
        };
        self.kinds.iter().map(counted).collect::<Vec<_>>().join(", ")
    }

    /// Whether any kind has a name that satisfies `is_kind`.
    fn any_kind(&self, is_kind: fn(&str) -> bool) -> bool {
        self.kinds.iter().any(|(kind, _)| is_kind(kind))
    }

    /// Whether there is packed geometry.
    fn has_packed(&self) -> bool {
        self.any_kind(|kind| kind.starts_with("Packed") || kind.starts_with("AlembicRef "))
    }

    /// Advice for a message: how to make polygons of the primitives.
    pub(super) fn mesh_remedy(&self) -> &'static str {
        if self.has_packed() {
            "unpack packed geometry with an Unpack SOP before saving"
        } else if self.any_kind(|kind| kind.ends_with("volume")) {
            "convert volumes to polygons with a Convert Volume SOP or a Convert VDB SOP"
        } else {
            "convert them to polygons with a Convert SOP"
        }
    }

    /// Advice for a message: how to get particles from a geometry that contains only primitives.
    #[must_use]
    pub fn remedy(&self) -> &'static str {
        if self.has_packed() {
            "unpack packed geometry with an Unpack SOP before saving"
        } else if self.any_kind(|kind| kind.ends_with("volume")) {
            "volumes are not particles, but a Points from Volume SOP makes particles from a volume"
        } else {
            "to use points of primitives as particles, delete the primitives but keep the points \
             with an Add SOP"
        }
    }
}

impl fmt::Display for Primitives {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kinds = self.counted();
        let is_one = matches!(self.kinds[..], [(_, 1)]);
        let whose = if is_one { "its" } else { "their" };
        match self.points {
            1 => write!(f, "{kinds} and {whose} point"),
            points => write!(f, "{kinds} and {whose} {points} points"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nouns_and_pronouns_agree_with_the_numbers_of_primitives() {
        for (stored, points, text) in [
            (&[("Volume", 1)][..], 1, "1 volume and its point"),
            (&[("VDB", 2)], 2, "2 VDB volumes and their 2 points"),
            (&[("Poly", 1)], 4, "1 polygon and its 4 points"),
            (&[("p_r", 2), ("Poly", 1)], 8, "3 polygons and their 8 points"),
            (
                &[("Sphere", 1), ("Tube", 2)],
                1,
                "1 Sphere primitive, 2 Tube primitives and their point",
            ),
        ] {
            assert_eq!(Primitives::new(stored.iter().copied(), points).to_string(), text);
        }
    }
}
