use coaxis::estimation::cylinder::explore;
use coaxis::scan::synthetic::*;
use coaxis::geometry::AxisLine;
#[test]
fn explore_scenes() {
    let base = |seed: u64| Part { arc_deg: 120.0, ..Part::smooth(seed) };
    let inter = |s: f64, t: f64, c: f64, a: f64, h: f64| Interference { screw_holes: s, straight_holes: t, clamps: c, clamp_arc: a, clamp_height_mm: h };
    let scenes: Vec<(&str, Box<dyn Fn(u64) -> Part>)> = vec![
        ("clean", Box::new(move |s| base(s))),
        ("paper", Box::new(move |s| Part { interference: inter(0.2, 0.16, 0.24, 0.5, 25.0), ..base(s) })),
        ("hard", Box::new(move |s| Part { interference: inter(0.2, 0.15, 0.5, 0.5, 25.0), ..base(s) })),
        ("nosmooth", Box::new(move |s| Part { interference: inter(0.3, 0.2, 0.5, 0.5, 25.0), ..base(s) })),
        ("clamp50", Box::new(move |s| Part { interference: inter(0.0, 0.0, 0.9, 0.5, 25.0), ..base(s) })),
        ("clamp70", Box::new(move |s| Part { interference: inter(0.0, 0.0, 0.857, 0.7, 25.0), ..base(s) })),
        ("clamp85", Box::new(move |s| Part { interference: inter(0.0, 0.0, 0.847, 0.85, 25.0), ..base(s) })),
        ("drop30", Box::new(move |s| Part { drop_out_ratio: 0.3, ..base(s) })),
        ("spike5", Box::new(move |s| Part { spike_ratio: 0.05, ..base(s) })),
        ("sigma.2", Box::new(move |s| Part { noise_sigma_mm: 0.2, interference: inter(0.2, 0.16, 0.24, 0.5, 25.0), ..base(s) })),
        ("sparse40", Box::new(move |s| Part { profiles_count: 40, points_count: 160, interference: inter(0.2, 0.16, 0.24, 0.5, 25.0), ..base(s) })),
        ("len50", Box::new(move |s| Part { length_mm: 50.0, ..base(s) })),
        ("arc50", Box::new(move |s| Part { arc_deg: 50.0, ..base(s) })),
        ("arc70", Box::new(move |s| Part { arc_deg: 70.0, interference: inter(0.2, 0.16, 0.24, 0.5, 25.0), ..base(s) })),
        ("arc90", Box::new(move |s| Part { arc_deg: 90.0, interference: inter(0.2, 0.16, 0.24, 0.5, 25.0), ..base(s) })),
        ("R20", Box::new(move |s| Part { radius_mm: 20.0, interference: inter(0.2, 0.16, 0.24, 0.5, 5.0), ..base(s) })),
        ("R50", Box::new(move |s| Part { radius_mm: 50.0, interference: inter(0.2, 0.16, 0.24, 0.5, 25.0), ..base(s) })),
        ("R1000", Box::new(move |s| Part { radius_mm: 1000.0, interference: inter(0.2, 0.16, 0.24, 0.5, 25.0), ..base(s) })),
        ("tilt10", Box::new(move |s| Part { axis: AxisLine { p: 0.17, q: -0.17, y0: 5.0, z0: 100.0 }, interference: inter(0.2, 0.16, 0.24, 0.5, 25.0), ..base(s) })),
    ];
    let n: u64 = std::env::var("SEEDS").ok().and_then(|s| s.parse().ok()).unwrap_or(10);
    for (name, f) in &scenes { if std::env::var("ONLY").is_ok_and(|o| !name.contains(&o)) { continue }
        let mut sq = [0.0f64; 5]; let mut worst = 0.0f64; let mut fails = 0; let mut cover = [0; 5]; let mut time = 0.0;
        for seed in 0..n {
            let part = f(seed);
            let (scan, truth) = make(&part).unwrap();
            let t = std::time::Instant::now();
            let r = explore(&scan);
            time += t.elapsed().as_secs_f64();
            let Some((c, sd, _)) = r else { fails += 1; continue };
            let b = truth.bound.unwrap();
            let e = [(c[0].atan().to_degrees() - truth.deflection_deg) / b.deflection_deg, (c[1].atan().to_degrees() - truth.pitch_deg) / b.pitch_deg,
                (c[2] - truth.y_ref_mm) / b.y_ref_mm, (c[3] - truth.z_ref_mm) / b.z_ref_mm, (c[4] - truth.radius_mm) / b.radius_mm];
            let sdb = [sd[0].to_degrees() / b.deflection_deg, sd[1].to_degrees() / b.pitch_deg, 0.0, 0.0, sd[4] / b.radius_mm];
            let m = e.iter().fold(0.0f64, |a, b| a.max(b.abs()));
            if m > 10.0 { fails += 1; if fails < 3 { println!("   {name} seed {seed}: {e:.1?} r {:.2}", c[4]); } continue }
            worst = worst.max(m);
            for i in 0..5 { sq[i] += e[i] * e[i]; if e[i].abs() < 2.0 * sdb[i] { cover[i] += 1 } }
        }
        let k = (n - fails).max(1) as f64;
        println!("{name:9} fails {fails} rms {:.2?} worst {worst:.1} cover {cover:?} ms {:.1}", sq.map(|s| (s / k).sqrt()), time / n as f64 * 1e3);
    }
}
