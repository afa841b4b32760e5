//! A pair of axes on the page: positions of values in pixels, frame, grid, ticks and labels.

use super::palette::{FAINT_INK, GRID, INK};
use super::scale::{Range, quantile};
use super::svg::{Anchor, Area, Svg, Type};

/// Size of the numbers and labels along the axes.
const SMALL: Type = Type::sized(11.0).colour(FAINT_INK);

/// A pair of axes over an area of the page.
#[derive(Debug, Clone, Copy)]
pub(super) struct Panel {
    pub(super) area: Area,
    pub(super) x: Range,
    pub(super) y: Range,
}

/// Position of a pair of values: in the panel, or beyond its border in a direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Spot {
    Inside([f64; 2]),
    /// The nearest position on the border and the unit vector that points outwards.
    Beyond([f64; 2], [f64; 2]),
}

impl Panel {
    pub(super) fn new(area: Area, x: Range, y: Range) -> Self {
        Self { area, x, y }
    }

    /// Equal scales on both axes, with the square of ±`half` about `centre` as large as it fits.
    pub(super) fn equal(area: Area, [x, y]: [f64; 2], half: f64) -> Self {
        let scale = Range::about_zero(half).width() / area.width.min(area.height);
        let range = |middle: f64, pixels: f64| Range::new(middle - scale * pixels / 2.0, middle + scale * pixels / 2.0);
        Self::new(area, range(x, area.width), range(y, area.height))
    }

    /// Equal scales on both axes with a range for most of the points: a few stray ones would shrink the others to a dot.
    pub(super) fn around(area: Area, points: &[[f64; 2]]) -> Self {
        let bulk = |coordinate: fn(&[f64; 2]) -> f64| {
            let mut values: Vec<f64> = points.iter().map(coordinate).collect();
            let [lo, hi] = [0.005, 0.995].map(|part| quantile(&mut values, part).unwrap_or(0.0));
            Range::new(lo, hi)
        };
        let (x, y) = (bulk(|[x, _]| *x), bulk(|[_, y]| *y));
        Self::equal(area, [x.middle(), y.middle()], 0.6 * x.width().max(y.width()))
    }

    /// Pixels of a pair of values, also outside the area.
    pub(super) fn place(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [
            self.area.left + (x - self.x.lo) / self.x.width() * self.area.width,
            self.area.bottom() - (y - self.y.lo) / self.y.width() * self.area.height,
        ]
    }

    /// Position of a pair of finite values.
    pub(super) fn spot(&self, values: [f64; 2]) -> Spot {
        let [x, y] = self.place(values);
        let nearest = [x.clamp(self.area.left, self.area.right()), y.clamp(self.area.top, self.area.bottom())];
        let [dx, dy] = [x - nearest[0], y - nearest[1]];
        let beyond = dx.hypot(dy);
        if beyond < 0.05 { Spot::Inside([x, y]) } else { Spot::Beyond(nearest, [dx / beyond, dy / beyond]) }
    }

    /// Frame, grid, numbers and labels; the data are drawn on top of them.
    pub(super) fn draw(&self, svg: &mut Svg, x_label: &str, y_label: &str) {
        let Area { left, top, width, height } = self.area;
        let (right, bottom) = (self.area.right(), self.area.bottom());
        let paint = format!("stroke=\"{GRID}\" stroke-width=\"0.8\"");
        let x_ticks = self.x.ticks((width / 80.0).max(2.0));
        for &value in &x_ticks.values {
            let [x, _] = self.place([value, self.y.lo]);
            svg.line([x, top], [x, bottom], &paint);
            svg.text([x, bottom + 18.0], SMALL.anchor(Anchor::Middle), &x_ticks.label(value));
        }
        let y_ticks = self.y.ticks((height / 40.0).max(2.0));
        let mut widest = 36.0;
        for &value in &y_ticks.values {
            let [_, y] = self.place([self.x.lo, value]);
            svg.line([left, y], [right, y], &paint);
            let number = y_ticks.label(value);
            svg.text([left - 9.0, y + 4.0], SMALL.anchor(Anchor::End), &number);
            widest = SMALL.width_of(&number).max(widest);
        }
        let [middle_x, middle_y] = self.area.middle();
        let label = SMALL.colour(INK).anchor(Anchor::Middle);
        svg.text([middle_x, bottom + 34.0], label, &x_ticks.with_base(x_label));
        svg.text([left - 18.0 - widest, middle_y], label.turned(), &y_ticks.with_base(y_label));
        self.frame(svg);
    }

    /// The frame alone, for drawing it again over content that reaches its edge.
    pub(super) fn frame(&self, svg: &mut Svg) {
        svg.rect(self.area, format_args!("fill=\"none\" stroke=\"{FAINT_INK}\" stroke-width=\"0.8\""));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_beyond_the_border_are_marked_on_it() {
        let panel = Panel::new(Area::new(10.0, 10.0, 100.0, 50.0), Range::new(0.0, 1.0), Range::new(0.0, 1.0));
        assert_eq!(panel.spot([0.5, 0.5]), Spot::Inside([60.0, 35.0]));
        assert_eq!(panel.spot([0.5, 9.0]), Spot::Beyond([60.0, 10.0], [0.0, -1.0]));
    }

    #[test]
    fn equal_scales_are_equal() {
        let panel = Panel::equal(Area::new(0.0, 0.0, 300.0, 200.0), [5.0, 7.0], 100.0);
        assert!((panel.x.width() / 300.0 - panel.y.width() / 200.0).abs() < 1e-12);
        assert!((panel.y.width() - 200.0).abs() < 1e-9 && (panel.x.middle() - 5.0).abs() < 1e-9);
    }
}
