//! A quick stability study of every engine finds no fault, and finds each planted fault.

use presight_features::{BoxQuery, FeaturePrediction, FeatureSamples, OcclusionHint, add_boxes};
use presight_model::error::Result;
use presight_predict::engine::{Device, Engine, EngineKind};
use presight_render::plan::{FramePlan, Images, Stats, Work};
use presight_render::verify::Precision;
use presight_studies::stability::{
    Outcome, Row, RunInfo, Study, Subject, all, faults, subjects, to_csv, to_html, to_json,
};
use presight_testkit::skip;

fn described(rows: &[Row]) -> Vec<String> {
    let of = |r: &Row| format!("{} at {:e}, {}: {}", r.family, r.difficulty, r.finding.engine, r.finding.note);
    rows.iter().filter(|r| r.finding.outcome == Outcome::Fault).map(of).collect()
}

/// `PRESIGHT_FULL` runs all difficulties.
#[test]
fn no_engine_has_a_fault() {
    let (mut engines, notes) = subjects(1).unwrap();
    for note in &notes {
        eprintln!("{note}");
        if cfg!(feature = "gpu") && note.starts_with("SKIPPED") {
            skip::no_adapter(note);
        }
    }
    let study = Study::new(std::env::var_os("PRESIGHT_FULL").is_none());
    let start = std::time::Instant::now();
    let rows = study.run(&mut engines, |_| {}).unwrap();
    eprintln!("{} rows in {:?}", rows.len(), start.elapsed());
    let found = described(&rows);
    assert!(found.is_empty(), "{} faults:\n{}", found.len(), found.join("\n"));
    assert_eq!(faults(&rows), 0);
    for family in &study.families {
        let own = || rows.iter().filter(|r| r.family == family.name());
        let engines = own().filter(|r| r.finding.outcome == Outcome::Ok && r.finding.engine == "cpu").count();
        assert!(engines >= 2, "{} tries the CPU engine", family.name());
    }
    // Unusable input was refused.
    for (family, difficulty) in
        [("offset", 1e13), ("corners", 65.0), ("dent", 0.1), ("warp", 1e-2), ("indefinite", 0.1)]
    {
        let of = |r: &Row| r.family == family && r.difficulty == difficulty && r.finding.outcome == Outcome::Rejected;
        assert!(rows.iter().any(of), "{family} at {difficulty:e} is refused");
    }
    let about = RunInfo { notes, ..RunInfo::default() };
    let (csv, html) = (to_csv(&rows), to_html(&study, &rows, &about).unwrap());
    assert_eq!(csv.lines().count(), rows.len() + 1);
    assert!(csv.starts_with("family,difficulty,engine,error,bound,outcome\ngrazing,1e0,reference,"), "{csv}");
    assert!(html.matches("<svg").count() >= study.families.len(), "a chart a family");
    let json: serde_json::Value = serde_json::from_str(&to_json(&study, &rows, &about).unwrap()).unwrap();
    assert_eq!(json["rows"].as_array().unwrap().len(), rows.len());
    assert_eq!(json["faults"], 0);
    check_left_out(&rows, &html, &json);
}

/// In f32 a plate at a grazing angle of 1e-9 rad is omitted as edge-on and the surface behind it shows. Every output
/// has to report that.
fn check_left_out(rows: &[Row], html: &str, json: &serde_json::Value) {
    let Some(at) = rows.iter().position(|r| r.family == "grazing" && r.difficulty < 2e-9 && r.finding.engine == "gpu")
    else {
        return;
    };
    let found = &rows[at].finding;
    assert!(found.other > 0 && found.edge_on > 0 && found.bound == f64::INFINITY && found.error > 0.5, "{found:?}");
    assert!(found.note.contains("left out as edge-on"), "{found:?}");
    assert_eq!(json["rows"][at]["other_pixels"], found.other);
    assert_eq!(json["rows"][at]["edge_on_polygons"], found.edge_on);
    assert!(
        html.contains("there is no bound from 1e-6 on for gpu and gpu-32-bit"),
        "the missing bound is not reported"
    );
    let exact = |r: &&Row| r.family == "grazing" && r.finding.engine == "cpu";
    assert!(rows.iter().filter(exact).all(|r| r.finding.other == 0 && r.finding.edge_on == 0));
}

/// The CPU engine with a planted fault. It reports itself as a device, so that the study requests boxes from it.
struct Spoiled {
    cpu: Box<dyn Engine>,
    images: fn(&mut Images),
    covariances: fn(&mut FeaturePrediction),
}

impl Engine for Spoiled {
    fn name(&self) -> String {
        "spoiled".into()
    }

    fn precision(&self) -> Precision {
        self.cpu.precision()
    }

    fn render(&mut self, plan: &FramePlan, images: &mut Images, stats: &mut Stats) -> Result<()> {
        self.cpu.render(plan, images, stats)?;
        (self.images)(images);
        Ok(())
    }

    fn device(&mut self) -> Option<&mut dyn Device> {
        Some(self)
    }
}

impl Device for Spoiled {
    fn adapter(&self) -> String {
        self.name()
    }

    fn reopen(&mut self) -> Result<()> {
        Ok(())
    }

    fn takes_features(&self) -> bool {
        true
    }

    fn holds_images(&self) -> bool {
        false
    }

    fn query_occlusion(&mut self, _: &FeatureSamples<'_>) -> Result<Vec<OcclusionHint>> {
        Ok(Vec::new())
    }

    fn add_boxes(&mut self, prediction: &mut FeaturePrediction, query: &BoxQuery<'_>) -> Result<usize> {
        add_boxes(prediction, query)?;
        (self.covariances)(prediction);
        Ok(0)
    }

    fn work(&self) -> Work {
        Work::default()
    }
}

/// Counts the faults that the study finds in these families with a spoiled engine, at their first difficulty.
fn found(families: &[&str], images: fn(&mut Images), covariances: fn(&mut FeaturePrediction)) -> usize {
    let cpu = EngineKind::Cpu.open(&1.into()).unwrap();
    let engine = Box::new(Spoiled { cpu, images, covariances });
    let mut spoiled = [Subject { name: "spoiled".into(), engine, threads: 1.into() }];
    let families: Vec<_> = all().into_iter().filter(|f| families.contains(&f.name())).collect();
    let first = |f: &dyn presight_studies::stability::Family| {
        let findings = f.measure(f.difficulties(true)[0], true, &mut spoiled).unwrap();
        findings.iter().filter(|f| f.outcome == Outcome::Fault).count()
    };
    families.iter().map(|f| f.as_ref()).map(first).sum()
}

#[test]
fn planted_faults_are_found() {
    let scenes = ["grazing", "scale"];
    let boxes = ["condition", "stiff"];
    assert_eq!(found(&scenes, |_| {}, |_| {}), 0, "nothing planted");
    assert_eq!(found(&boxes, |_| {}, |_| {}), 0, "nothing planted");
    let farther = |i: &mut Images| {
        if let Some(at) = i.range.iter().position(|r| r.is_finite()) {
            i.range[at] *= 1.0 + 1e-4;
        }
    };
    assert_eq!(found(&scenes, farther, |_| {}), 2, "a range off by 1e-4");
    let other = |i: &mut Images| {
        if let Some(at) = i.polygon_id.iter().position(|id| *id > 0) {
            (i.polygon_id[at], i.object_id[at]) = if i.polygon_id[at] == 1 { (2, 2) } else { (1, 1) };
        }
    };
    assert_eq!(found(&scenes, other, |_| {}), 2, "a wrong id");
    let nan = |i: &mut Images| {
        if let Some(at) = i.range.iter().position(|r| r.is_finite()) {
            i.cos_incidence[at] = f32::NAN;
        }
    };
    assert_eq!(found(&scenes, nan, |_| {}), 2, "an angle that is NaN");
    let single = |found: &mut FeaturePrediction| {
        let all = found.features.iter_mut().filter_map(|f| f.image_covariance.as_mut()).flatten();
        all.for_each(|c| c.as_flattened_mut().iter_mut().for_each(|x| *x = f64::from(*x as f32)));
    };
    assert_eq!(found(&boxes, |_| {}, single), 2, "covariances in f32");
    let narrow = |found: &mut FeaturePrediction| {
        for [x0, _, x1, _] in found.features.iter_mut().filter_map(|f| f.roi.as_mut()) {
            let (middle, half) = (0.5 * (*x0 + *x1), 0.3 * (*x1 - *x0));
            (*x0, *x1) = (middle - half, middle + half);
        }
    };
    assert_eq!(found(&["condition-box"], |_| {}, narrow), 1, "boxes that are too narrow");
    assert_eq!(found(&["condition-box"], |_| {}, |f| f.features.iter_mut().for_each(|f| f.roi = None)), 1, "no boxes");
}
