//! Markers, those of one kind combined into one path so that the file stays small, and the legend that explains them.

use super::panel::{Panel, Spot};
use super::svg::{Area, Px, Svg, Type};
use std::collections::HashSet;
use std::fmt::Write as _;

/// The shape of a marker.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Symbol {
    /// A dot of two pixels.
    Speck,
    /// A dot of four pixels.
    Dot,
    Ring,
    Square,
    Diamond,
    Cross,
    Plus,
    /// A piece of a line.
    Stroke,
    /// A piece of a dashed line.
    Dashes,
    /// A filled field.
    Field,
    /// The arrow of a value off the scale.
    Arrow,
}

impl Symbol {
    /// Path data of one marker.
    fn data(self, [x, y]: [f64; 2]) -> String {
        let at = |dx: f64, dy: f64| format!("M{} {}", Px(x + dx), Px(y + dy));
        match self {
            // A line of zero length with round ends: the shortest way to write a dot.
            Self::Speck | Self::Dot => at(0.0, 0.0) + "h0",
            Self::Ring => at(-3.2, 0.0) + "a3.2 3.2 0 1 0 6.4 0a3.2 3.2 0 1 0-6.4 0",
            Self::Square => at(-2.8, -2.8) + "h5.6v5.6h-5.6z",
            Self::Diamond => at(0.0, -4.0) + "l4 4l-4 4l-4-4z",
            Self::Cross => at(-2.8, -2.8) + "l5.6 5.6m0-5.6l-5.6 5.6",
            Self::Plus => at(-3.6, 0.0) + "h7.2m-3.6-3.6v7.2",
            Self::Stroke | Self::Dashes => at(-9.0, 0.0) + "h18",
            Self::Field => at(-9.0, -5.0) + "h18v10h-18z",
            Self::Arrow => arrow([x, y - 5.5], [0.0, -1.0]),
        }
    }

    /// The attributes that give a marker its colour.
    pub(super) fn paint(self, colour: &str) -> String {
        let stroke =
            |width: f64, more: &str| format!("fill=\"none\" stroke=\"{colour}\" stroke-width=\"{width}\"{more}");
        match self {
            Self::Speck => stroke(2.0, " stroke-linecap=\"round\""),
            Self::Dot => stroke(4.0, " stroke-linecap=\"round\""),
            Self::Square | Self::Diamond | Self::Field => format!("fill=\"{colour}\""),
            Self::Cross | Self::Plus | Self::Ring | Self::Stroke => stroke(1.4, ""),
            Self::Arrow => stroke(1.2, ""),
            Self::Dashes => stroke(1.2, " stroke-dasharray=\"4 3\""),
        }
    }

    /// Draws a single marker.
    pub(super) fn draw(self, svg: &mut Svg, at: [f64; 2], colour: &str) {
        svg.path(&self.data(at), self.paint(colour));
    }
}

/// Markers of one kind on one panel.
pub(super) struct Marks {
    symbol: Symbol,
    colour: &'static str,
    inside: String,
    arrows: String,
    /// Pieces of the border that already have an arrow: adjacent arrows would merge into a block.
    taken: HashSet<(i32, i32)>,
    beyond_count: usize,
}

/// Length of the border for one arrow, pixels.
const ARROW_ROOM: f64 = 7.0;

impl Marks {
    pub(super) fn new(symbol: Symbol, colour: &'static str) -> Self {
        let (inside, arrows) = (String::new(), String::new());
        Self { symbol, colour, inside, arrows, taken: HashSet::new(), beyond_count: 0 }
    }

    /// Adds a marker. Beyond the border it is an arrow in its colour that points to the border, because its own shape there would
    /// be mistaken for a value.
    pub(super) fn add(&mut self, panel: &Panel, values: [f64; 2]) {
        match panel.spot(values) {
            Spot::Inside(at) => self.inside += &self.symbol.data(at),
            Spot::Beyond(at, outwards) => {
                self.beyond_count += 1;
                let [x, y] = at.map(|pixels| (pixels / ARROW_ROOM) as i32);
                if self.taken.insert((x, y)) {
                    self.arrows += &arrow(at, outwards);
                }
            }
        }
    }

    /// Draws all markers; returns how many lie beyond the border.
    pub(super) fn draw(&self, svg: &mut Svg) -> usize {
        svg.path(&self.inside, self.symbol.paint(self.colour));
        svg.path(&self.arrows, Symbol::Arrow.paint(self.colour));
        self.beyond_count
    }
}

/// An arrow with its tip at (x, y), pointing along the unit vector (dx, dy).
fn arrow([x, y]: [f64; 2], [dx, dy]: [f64; 2]) -> String {
    let place = |along: f64, across: f64| (Px(x + along * dx - across * dy), Px(y + along * dy + across * dx));
    let ((ax, ay), (bx, by), (cx, cy)) = (place(-11.0, 0.0), place(-4.0, 3.0), place(-4.0, -3.0));
    let (x, y) = (Px(x), Px(y));
    let mut data = String::new();
    // Writing to a string cannot fail.
    let _ = write!(data, "M{ax} {ay}L{x} {y}M{bx} {by}L{x} {y}L{cx} {cy}");
    data
}

/// The stride at which at most `most` of `count` items are drawn.
pub(super) fn stride(count: usize, most: usize) -> usize {
    count.div_ceil(most.max(1)).max(1)
}

/// A polyline through positions on the page.
pub(super) fn polyline(places: impl Iterator<Item = [f64; 2]>) -> String {
    let mut data = String::new();
    for [x, y] in places {
        let step = if data.is_empty() { 'M' } else { 'L' };
        // Writing to a string cannot fail.
        let _ = write!(data, "{step}{} {}", Px(x), Px(y));
    }
    data
}

/// Size of the text.
const LOOK: Type = Type::sized(12.0);
/// Height of a row, pixels.
const ROW: f64 = 20.0;

/// A marker and its meaning.
pub(super) struct Entry {
    /// Shape and colour; none for a remark.
    marker: Option<(Symbol, &'static str)>,
    text: String,
}

impl Entry {
    pub(super) fn new(symbol: Symbol, colour: &'static str, text: impl Into<String>) -> Self {
        Self { marker: Some((symbol, colour)), text: text.into() }
    }

    /// Text without a marker.
    pub(super) fn remark(text: impl Into<String>) -> Self {
        Self { marker: None, text: text.into() }
    }
}

/// Draws the entries from the top left of `area`, as many to a row as fit its width; returns the lower edge of the last row.
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
