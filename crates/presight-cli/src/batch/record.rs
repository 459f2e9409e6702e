//! The record of a batch in its folder: another run goes on only with the same scene, sensor, poses, request and engine.

use presight::tools::{self, write_atomically};
use presight::{Backend, Error, Raster, Result};
use std::io::Write as _;
use std::path::Path;

/// The file that identifies the batch of a folder.
pub(super) const JOB: &str = "batch.json";

/// The engine and the rasterizer of a batch; `None` if not chosen yet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Choice {
    pub backend: Option<Backend>,
    pub raster: Option<Raster>,
}

/// The engines that a batch can use, with their names in its record.
const BACKENDS: [(Backend, &str); 2] = [(Backend::Cpu, "cpu"), (Backend::Gpu, "gpu")];

/// Checks that the folder holds this batch or none. Returns the engine and the rasterizer to use: the ones of the
/// batch's first run, so that all its images are alike, or else the given ones.
pub(super) fn check_job(folder: &Path, job: &serde_json::Value, given: Choice) -> Result<Choice> {
    let path = folder.join(JOB);
    if !path.exists() {
        return Ok(given);
    }
    let record = tools::read_settings(&path)?;
    same_job(&record, job, given).map_err(|e| e.in_file(&path))
}

fn same_job(record: &str, job: &serde_json::Value, given: Choice) -> Result<Choice> {
    let remedy = "choose another --out, or remove the folder";
    let broken = |e| Error::invalid(format!("it is not a valid record of a batch: {e}"), remedy);
    let before: serde_json::Value = serde_json::from_str(record).map_err(broken)?;
    let names = ["format", "presight", "scene", "sensor", "poses", "request"];
    if let Some(name) = names.iter().find(|name| before[**name] != job[**name]) {
        let what = match *name {
            "scene" => "the scene has changed since this batch began",
            "sensor" => "this batch began with another sensor",
            "poses" => "this batch began with other poses",
            "request" => "this batch began with another measured image or other flags",
            _ => "another version of presight began this batch",
        };
        return Err(Error::invalid(what, remedy));
    }
    let other = |flag: &str| {
        Error::invalid(format!("this batch began with another {flag}"), "drop it, or choose another --out")
    };
    // Older records name no engine, and still older ones no rasterizer either.
    let raster = before["raster"].as_str().unwrap_or(Raster::default().name());
    let raster = [Raster::Compute, Raster::Render].into_iter().find(|r| r.name() == raster);
    let raster = raster.filter(|r| given.raster.is_none_or(|given| given == *r)).ok_or_else(|| other("--raster"))?;
    let backend = match before["backend"].as_str() {
        None => given.backend,
        Some(name) => {
            let backend = BACKENDS.into_iter().find(|(_, n)| *n == name).map(|(backend, _)| backend);
            let backend = backend.filter(|b| given.backend.is_none_or(|given| given == *b));
            Some(backend.ok_or_else(|| other("--backend"))?)
        }
    };
    Ok(Choice { backend, raster: Some(raster) })
}

/// Records the batch in the folder with the engine and the rasterizer in use. If another shard was faster, checks that
/// it uses the same ones.
pub(super) fn keep_job(folder: &Path, mut job: serde_json::Value, used: Choice) -> Result<()> {
    let path = folder.join(JOB);
    if path.exists() {
        return check_job(folder, &job, used).map(drop);
    }
    job["raster"] = used.raster.map(Raster::name).into();
    let backend = BACKENDS.into_iter().find(|(backend, _)| used.backend == Some(*backend));
    job["backend"] = backend.map(|(_, name)| name).into();
    write_atomically(&path, |file| writeln!(file, "{job:#}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_batch_goes_on_with_the_engine_and_rasterizer_that_it_began_with() {
        let folder = tempfile::tempdir().unwrap();
        let job = || serde_json::json!({ "format": 1, "scene": "hall" });
        let asked = |backend, raster| check_job(folder.path(), &job(), Choice { backend, raster });
        let none = Choice { backend: None, raster: None };
        assert_eq!(asked(None, None).unwrap(), none, "no engine is chosen before the first run");
        let used = Choice { backend: Some(Backend::Cpu), raster: Some(Raster::Render) };
        keep_job(folder.path(), job(), used).unwrap();
        for (backend, raster) in [(None, None), (Some(Backend::Cpu), None), (None, Some(Raster::Render))] {
            assert_eq!(asked(backend, raster).unwrap(), used);
        }
        let refused = |choice: Result<Choice>| choice.unwrap_err().to_string();
        assert!(refused(asked(None, Some(Raster::Compute))).contains("this batch began with another --raster"));
        assert!(refused(asked(Some(Backend::Gpu), None)).contains("this batch began with another --backend"));
        let of_gpu = Choice { backend: Some(Backend::Gpu), ..used };
        assert!(keep_job(folder.path(), job(), of_gpu).is_err(), "another shard began on the CPU");
        // An older record, which names no engine and no rasterizer.
        std::fs::write(folder.path().join(JOB), job().to_string()).unwrap();
        let compute = Choice { backend: Some(Backend::Gpu), raster: Some(Raster::Compute) };
        assert_eq!(asked(compute.backend, None).unwrap(), compute);
        assert!(asked(None, Some(Raster::Render)).is_err());
    }
}
