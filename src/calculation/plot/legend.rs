//! The legend: markers with their meaning, flowing into as many rows as the width asks for.

use super::area::Area;
use super::marks::Symbol;
use super::svg::{Svg, Type};

/// Size of the text.
const LOOK: Type = Type::sized(12.0);
/// Height of a row, pixels.
const ROW: f64 = 20.0;

/// A marker and its meaning.
pub(super) struct Entry {
    /// Shape and colour; a remark has none.
    marker: Option<(Symbol, &'static str)>,
    text: String,
}

impl Entry {
    pub(super) fn new(symbol: Symbol, colour: &'static str, text: impl Into<String>) -> Self {
        Self { marker: Some((symbol, colour)), text: text.into() }
    }

    /// Words without a marker.
    pub(super) fn remark(text: impl Into<String>) -> Self {
        Self { marker: None, text: text.into() }
    }
}

/// Draws the entries from the top left of `area`, as many to a row as fit its width; returns where they end.
pub(super) fn legend(svg: &mut Svg, area: Area, entries: &[Entry]) -> f64 {
    let [mut x, mut y] = [area.left, area.top + ROW / 2.0];
    for entry in entries {
        let width = 40.0 + LOOK.width_of(&entry.text);
        if x > area.left && x + width > area.right() {
            (x, y) = (area.left, y + ROW);
        }
        if let Some((symbol, colour)) = entry.marker {
            symbol.draw(svg, [x + 9.0, y], colour);
        }
        svg.text([x + 24.0, y + 4.0], LOOK, &entry.text);
        x += width;
    }
    y + ROW / 2.0
}
