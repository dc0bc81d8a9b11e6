//! The legend of a colour map, at the right edge of a picture.

use embedded_graphics::text::Alignment;

use super::colour::ColourMap;
use super::image::Image;

/// Shows the colours from `lo` to `hi`, and what they stand for: their ends for all `beyond`, too.
pub(super) fn legend(image: &mut Image, name: &str, map: ColourMap, [lo, hi]: [f32; 2], beyond: bool) {
    let (width, height) = (image.width() as i32, image.height() as i32);
    let line = image.line();
    let (bar, long) = (line, height / 3);
    let (left, top) = (width - 2 * line - bar, (height - long) / 2);
    for y in 0..long {
        let colour = map.of(1.0 - (y as f32 + 0.5) / long as f32);
        for x in 0..bar {
            if let (Ok(x), Ok(y)) = (usize::try_from(left + x), usize::try_from(top + y)) {
                image.set(x, y, colour);
            }
        }
    }
    image.text(name, [left + bar, top - 2 * line], Alignment::Right);
    let [below, above] = if beyond { ["<= ", ">= "] } else { [""; 2] };
    for (share, before, value) in [(0, above, hi), (1, "", lo / 2.0 + hi / 2.0), (2, below, lo)] {
        let y = top + long * share / 2 - line / 2;
        image.text(&format!("{before}{}", number(value)), [left - line / 2, y], Alignment::Right);
    }
}

/// A number in four digits, whatever its size.
fn number(value: f32) -> String {
    let size = value.abs();
    if size == 0.0 || (1e-2..1e4).contains(&size) { format!("{value:.3}") } else { format!("{value:.2e}") }
}
