//! Lends speeds to new tracks, whose own speed is unknown.

use super::motion::isotropic;
use super::options::TrackerOptions;
use super::track::Track;
use super::tracker::OLD_ENOUGH;
use glam::DVec2;

/// Number of neighbours that estimate the speed of a new track.
const NEIGHBOURS: usize = 8;

/// Places and speeds of the older tracks; `begun` has the rows of the new ones in order.
pub(super) fn known_speeds(tracks: &[Track], begun: &[usize]) -> Vec<(DVec2, DVec2)> {
    let speed = |t: &Track| t.motions.iter().map(|m| m.speed).sum::<DVec2>() / t.motions.len() as f64;
    let is_new = |i: &usize| begun.binary_search(i).is_ok();
    (0..tracks.len())
        .filter(|i| !is_new(i) && tracks[*i].seen >= OLD_ENOUGH && tracks[*i].misses == 0)
        .map(|i| (tracks[i].shape.centre(), speed(&tracks[i])))
        .collect()
}

/// Sets the speed of new tracks by the `known` places and speeds nearby. Returns true if that changed one.
pub(super) fn lend_speeds(
    tracks: &mut [Track],
    new: &[usize],
    known: &[(DVec2, DVec2)],
    options: &TrackerOptions,
) -> bool {
    let mut has_changed = false;
    if known.len() < NEIGHBOURS {
        return has_changed;
    }
    let mut near: Vec<(f64, DVec2)> = Vec::new();
    for i in new {
        let track = &mut tracks[*i];
        let at = track.shape.centre();
        near.clear();
        near.extend(known.iter().map(|(p, v)| (p.distance_squared(at), *v)));
        near.select_nth_unstable_by(NEIGHBOURS - 1, |a, b| a.0.total_cmp(&b.0));
        let near = &near[..NEIGHBOURS];
        let mean = near.iter().map(|n| n.1).sum::<DVec2>() / NEIGHBOURS as f64;
        let spread: f64 = near.iter().map(|n| n.1.distance_squared(mean)).sum::<f64>() / NEIGHBOURS as f64;
        // Twice the spread of the neighbours, because depths differ more than positions in the image.
        let variance = (2.0 * spread).max(options.residual_speed_sigma.powi(2));
        for motion in &mut track.motions {
            if variance < motion.vv.x_axis.x {
                motion.speed = mean;
                motion.vv = isotropic(variance);
                has_changed = true;
            }
        }
    }
    has_changed
}
