//! Weighted moments of the points of a profile, and the gradient and normal matrix that follow from them. Where all points lie
//! in one plane x = const, fifteen moments suffice, since the lever of the slopes follows from the direction; points with an x
//! of their own need nineteen.

use super::projection::Projection;
use super::sums::Sums;
use nalgebra::{Matrix2, Matrix5, Vector2, Vector5};

/// Sums over points with the direction (C, S) from the axis, the distance d from the surface, the axial offset s, Tukey's
/// weight w and the curvature k.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Moments {
    /// Σ w,
    pub(super) weight: f64,
    /// Σ w·d, w·d·C, w·d·S, w·d·C·s and w·d·S·s,
    pub(super) pull: [f64; 5],
    /// Σ k, k·C, k·S, k·C², k·CS, k·C³, k·C²S, k·C⁴ and k·C³S: with C² + S² = 1 they are all moments to the fourth order.
    pub(super) bend: [f64; 9],
}

/// Sums as those of [`Moments`] over points with an x of their own, with the lever t in place of s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct OwnMoments {
    /// Σ w,
    pub(super) weight: f64,
    /// Σ w·d, w·d·C, w·d·S, w·d·C·t and w·d·S·t,
    pub(super) pull: [f64; 5],
    /// Σ k, k·C, k·S, k·C² and k·CS,
    pub(super) bend: [f64; 5],
    /// Σ k·t, k·t·C, k·t·S, k·t·C², k·t·CS, k·t², k·t²·C² and k·t²·CS.
    pub(super) lever: [f64; 8],
}

impl Moments {
    /// The sums in the parameters along e₁ and e₂.
    ///
    /// The gradient is exact. In the normal matrix s is that of the foot on the surface, R(−e₁ₓC − e₂ₓS): off by d/R of a
    /// term that is small itself, as is the second derivative of ρ, which Gauss and Newton leave out.
    pub(super) fn sums(&self, projection: &Projection) -> Sums {
        let dx = projection.dx;
        let [wd, wdc, wds, wdcs, wdss] = self.pull;
        let [k, c, s, cc, cs, ccc, ccs, cccc, cccs] = self.bend;
        let (ss, css, sss) = (k - cc, c - ccc, s - ccs);
        let (ccss, csss) = (cc - cccc, cs - cccs);
        let ssss = ss - ccss;
        let [a, b] = projection.axial.map(|part| part * projection.radius);
        // Σ k·(C, S)ᵀ(C, S) times 1, s and s², and Σ k·(C, S) times 1 and s.
        let plain = Matrix2::new(cc, cs, cs, ss);
        let once = Matrix2::new(ccc, ccs, ccs, css) * a + Matrix2::new(ccs, css, css, sss) * b;
        let twice = Matrix2::new(cccc, cccs, cccs, ccss) * (a * a)
            + Matrix2::new(cccs, ccss, ccss, csss) * (2.0 * a * b)
            + Matrix2::new(ccss, csss, csss, ssss) * (b * b);
        let (lever, edge) = (plain * dx + once, Vector2::new(c, s));
        let slopes = plain * (dx * dx) + once * (2.0 * dx) + twice;
        let slope_edge = edge * dx + plain * Vector2::new(a, b);
        let mut normal = Matrix5::zeros();
        normal.fixed_view_mut::<2, 2>(0, 0).copy_from(&slopes);
        normal.fixed_view_mut::<2, 2>(0, 2).copy_from(&lever);
        normal.fixed_view_mut::<2, 2>(2, 0).copy_from(&lever);
        normal.fixed_view_mut::<2, 2>(2, 2).copy_from(&plain);
        normal.fixed_view_mut::<2, 1>(0, 4).copy_from(&slope_edge);
        normal.fixed_view_mut::<1, 2>(4, 0).copy_from(&slope_edge.transpose());
        normal.fixed_view_mut::<2, 1>(2, 4).copy_from(&edge);
        normal.fixed_view_mut::<1, 2>(4, 2).copy_from(&edge.transpose());
        normal.fixed_view_mut::<1, 1>(4, 4).fill(k);
        let gradient = -Vector5::new(wdc * dx + wdcs, wds * dx + wdss, wdc, wds, wd);
        Sums { gradient, normal, weight: self.weight }
    }
}

impl OwnMoments {
    /// The sums in the parameters along e₁ and e₂; both are exact but for the second derivative of ρ, which Gauss and Newton
    /// leave out.
    pub(super) fn sums(&self) -> Sums {
        let [wd, wdc, wds, wdct, wdst] = self.pull;
        let [k, c, s, cc, cs] = self.bend;
        let [t, tc, ts, tcc, tcs, tt, ttcc, ttcs] = self.lever;
        #[rustfmt::skip]
        let normal = Matrix5::new(
            ttcc, ttcs, tcc, tcs, tc,
            ttcs, tt - ttcc, tcs, t - tcc, ts,
            tcc, tcs, cc, cs, c,
            tcs, t - tcc, cs, k - cc, s,
            tc, ts, c, s, k,
        );
        Sums { gradient: -Vector5::new(wdct, wdst, wdc, wds, wd), normal, weight: self.weight }
    }
}
