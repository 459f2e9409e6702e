//! Memory: the amount that the system still grants this process, checked before work begins.
//!
//! Linux grants more memory than there is and kills programs that use it. A limit on address space makes allocations
//! fail in libraries that cannot return an error. Commands therefore estimate their needs and check here first.

use crate::error::{Error, ErrorKind, Result};
use crate::threads;
use std::path::Path;

/// The memory that a process may still use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MemoryLimit {
    /// Bytes.
    pub bytes: u64,
    /// The limit that applies, for messages.
    pub by: &'static str,
}

/// Address space that the C library reserves for each thread that allocates.
const ARENA: u64 = 64 << 20;

/// The memory left to this process: the least of the address space limit, the control groups (versions 1 and 2) and the
/// machine's free memory. `None` on systems other than Linux, which do not report these in files: there
/// [`require`] refuses nothing.
pub fn room() -> Option<MemoryLimit> {
    let read = |path: &str| std::fs::read_to_string(path).unwrap_or_default();
    let status = read("/proc/self/status");
    let addresses = address_limit(&read("/proc/self/limits")).map(|limit| {
        let left = limit.saturating_sub(kilobytes(&status, "VmSize:").unwrap_or(0));
        left - (ARENA * threads::cores() as u64).min(left / 4)
    });
    let groups = group_folders(&read("/proc/self/cgroup"), Path::new("/sys/fs/cgroup"));
    let groups = groups.iter().filter_map(|folder| left_in_group(folder)).min();
    let machine = read("/proc/meminfo");
    let machine = kilobytes(&machine, "MemAvailable:").map(|b| b + kilobytes(&machine, "SwapFree:").unwrap_or(0));
    let all = [
        (addresses, "the limit on its address space (ulimit -v)"),
        (groups, "the memory limit of its control group"),
        (machine, "the machine"),
    ];
    let told = all.into_iter().filter_map(|(bytes, by)| Some(MemoryLimit { bytes: bytes?, by }));
    told.min_by_key(|room| room.bytes)
}

/// Checks that this many more bytes are available.
///
/// # Errors
/// [`ErrorKind::System`], with the bytes needed and the bytes left.
pub fn require(bytes: u64) -> Result<()> {
    match (bytes > 0).then(room).flatten() {
        Some(room) if bytes > room.bytes => {
            let what =
                format!("this needs about {} of memory, but {} leaves {}", sized(bytes), room.by, sized(room.bytes));
            Err(Error::new(ErrorKind::System, what, REMEDY))
        }
        _ => Ok(()),
    }
}

/// An empty vector with reserved capacity.
///
/// # Errors
/// [`ErrorKind::System`] if the system refuses.
pub fn reserved<T>(len: usize) -> Result<Vec<T>> {
    let mut vector = Vec::new();
    reserve(&mut vector, len)?;
    Ok(vector)
}

/// Reserves capacity for exactly `len` elements in total.
///
/// # Errors
/// [`ErrorKind::System`] if the system refuses.
pub fn reserve<T>(vector: &mut Vec<T>, len: usize) -> Result<()> {
    vector.try_reserve_exact(len.saturating_sub(vector.len())).map_err(|e| {
        let what = format!("the system refuses {} of memory", sized(len.saturating_mul(size_of::<T>()) as u64));
        Error::new(ErrorKind::System, what, REMEDY).caused_by(e)
    })
}

/// Memory of one prediction and its files, in addition to the scene and the sensor.
#[derive(Clone, Copy, Debug, Default)]
pub struct FrameMemory {
    /// Columns times rows.
    pub pixels: u64,
    /// True for a scanner, whose images are transposed after drawing.
    pub scanner: bool,
    /// Predicted on a device instead of the CPU; the device's own memory is not counted.
    pub on_device: bool,
    /// Number of scalar images in memory, where a vector image is three.
    pub images: u64,
    /// Channels of the EXR file.
    pub exr: u64,
    /// Pixels of the picture, or 0.
    pub picture: u64,
    /// True if a depth image is written.
    pub depth_png: bool,
    /// Bytes per pixel of the points that are written.
    pub points: u64,
    /// Bytes per pixel that a virtual sensor reads from the images.
    pub reading: u64,
}

impl FrameMemory {
    /// Bytes of the images alone.
    pub fn of_images(&self) -> u64 {
        4 * self.images * self.pixels
    }

    /// Bytes at the peak: buffers and images stay allocated while one file after the other is written.
    pub fn bytes(&self) -> u64 {
        // Inverse depth and winner of the CPU engine, or the images read back from a device.
        let engine = if self.on_device { 4 * self.images } else { 16 };
        // For each band of at least 32 columns, a pointer and a length per row and image; padding of the buffers.
        let turning = if self.scanner { 1 + self.images.div_ceil(2) } else { 0 };
        let drawn = self.pixels * (engine + turning) + self.of_images() + self.pixels / 2;
        let files = [
            4 * self.exr * self.pixels,
            // Colours; per pixel, a border density and its sum; the page.
            if self.picture > 0 { 11 * self.pixels + 3 * self.picture } else { 0 },
            // Millimetres, their bytes, and the packed output.
            if self.depth_png { 7 * self.pixels } else { 0 },
            self.points * self.pixels,
        ];
        drawn + self.reading * self.pixels + files.into_iter().max().unwrap_or(0)
    }
}

/// Memory to import meshes with these numbers of triangles, in addition to the file.
pub fn of_meshes(triangles: impl Iterator<Item = u64>) -> u64 {
    let triangles: Vec<u64> = triangles.collect();
    let all = triangles.iter().fold(0u64, |sum, n| sum.saturating_add(*n));
    of_kept(all).saturating_add(of_building(triangles, threads::cores()))
}

/// Memory of triangles stored in meshes, if no two can be merged. Measured on wavy ground of 720,000 triangles.
pub fn of_kept(triangles: u64) -> u64 {
    const KEPT: u64 = 100;
    KEPT.saturating_mul(triangles)
}

/// Additional memory to build meshes with these numbers of triangles, `at_once` of them at a time. Measured per
/// triangle: 110 bytes for wavy ground, 160 if no two triangles share a vertex.
pub fn of_building(mut triangles: Vec<u64>, at_once: usize) -> u64 {
    const BUILT: u64 = 140;
    triangles.sort_unstable_by(|a, b| b.cmp(a));
    let built = triangles.iter().take(at_once).fold(0u64, |sum, n| sum.saturating_add(*n));
    BUILT.saturating_mul(built)
}

/// Memory of meshes that take `bytes` in a store, with or without the trees of an index. Measured on the same ground.
pub fn of_stored(bytes: u64, with_trees: bool) -> u64 {
    bytes + bytes / 10 * if with_trees { 7 } else { 3 }
}

/// Memory to write meshes into a store, from the polygons of each: the largest is laid out and copied. Measured as for
/// [`of_meshes`].
pub fn of_writing(polygons: impl Iterator<Item = u64>) -> u64 {
    const LAID_OUT: u64 = 110;
    LAID_OUT.saturating_mul(polygons.max().unwrap_or(0))
}

const REMEDY: &str = "raise the limit, close other programs, or request smaller or fewer images";

/// Formats bytes for messages.
fn sized(bytes: u64) -> String {
    match bytes {
        1_000_000_000.. => format!("{:.2} GB", bytes as f64 / 1e9),
        _ => format!("{:.0} MB", bytes as f64 / 1e6),
    }
}

/// The soft limit on address space in `/proc/self/limits`.
fn address_limit(limits: &str) -> Option<u64> {
    let line = limits.lines().find(|line| line.starts_with("Max address space"))?;
    line.split_whitespace().nth(3)?.parse().ok()
}

/// A line `Name:  123 kB`, in bytes.
fn kilobytes(text: &str, name: &str) -> Option<u64> {
    let line = text.lines().find(|line| line.starts_with(name))?;
    line.split_whitespace().nth(1)?.parse::<u64>().ok()?.checked_mul(1024)
}

/// Folders of the memory control groups of a process, inner ones first, for both versions.
fn group_folders(groups: &str, root: &Path) -> Vec<std::path::PathBuf> {
    let mut folders = Vec::new();
    for line in groups.lines() {
        let mut parts = line.splitn(3, ':').skip(1);
        let (Some(controllers), Some(path)) = (parts.next(), parts.next()) else { continue };
        let mount = match controllers {
            "" if root.join("unified").is_dir() => root.join("unified"),
            "" => root.to_owned(),
            _ if controllers.split(',').any(|c| c == "memory") => root.join("memory"),
            _ => continue,
        };
        // In a container the path may be that of the host, while the process's own group is mounted at the root.
        let inside = Path::new(path.trim_start_matches('/'));
        folders.extend(inside.ancestors().map(|part| mount.join(part)));
    }
    folders
}

/// The bytes that a group's limit leaves. Cached files do not count, because the kernel can drop them.
fn left_in_group(folder: &Path) -> Option<u64> {
    let number = |name: &str| std::fs::read_to_string(folder.join(name)).ok()?.trim().parse::<u64>().ok();
    let limit = number("memory.max").or_else(|| number("memory.limit_in_bytes"))?;
    let used = number("memory.current").or_else(|| number("memory.usage_in_bytes"))?;
    let stat = std::fs::read_to_string(folder.join("memory.stat")).unwrap_or_default();
    let of = |name: &str| {
        let mut lines = stat.lines().filter_map(|line| line.split_once(' '));
        lines.find(|(key, _)| *key == name).and_then(|(_, n)| n.trim().parse::<u64>().ok())
    };
    let cached = |kind: &str| of(&format!("total_{kind}")).or_else(|| of(kind)).unwrap_or(0);
    let cached = cached("inactive_file") + cached("active_file");
    Some(limit.saturating_sub(used.saturating_sub(cached)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_takes_the_bytes_of_its_images() {
        let frame = FrameMemory { pixels: 1_000_000, images: 4, exr: 4, ..FrameMemory::default() };
        assert!((48_000_000..50_000_000).contains(&frame.bytes()), "{}", frame.bytes());
    }

    #[test]
    fn texts_of_the_system_are_read() {
        let limits = "Limit                     Soft Limit           Hard Limit           Units     \n\
            Max cpu time              unlimited            unlimited            seconds   \n\
            Max address space         3072000000           unlimited            bytes     \n";
        assert_eq!(address_limit(limits), Some(3_072_000_000));
        assert_eq!(address_limit(&limits.replace("3072000000", "unlimited ")), None);
        assert_eq!(kilobytes("VmPeak:\t  9 kB\nVmSize:\t    2048 kB\n", "VmSize:"), Some(2 << 20));
    }

    #[test]
    fn groups_of_both_versions_leave_what_their_limits_say() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| {
            let path = folder.path().join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, text).unwrap();
        };
        let left = |groups: &str| {
            let folders = group_folders(groups, folder.path());
            folders.iter().filter_map(|f| left_in_group(f)).collect::<Vec<_>>()
        };
        // Version 2: the inner group has no limit, the outer one leaves 1000 - (600 - 150) bytes.
        write("a/b/memory.max", "max\n");
        write("a/b/memory.current", "500\n");
        write("a/memory.max", "1000\n");
        write("a/memory.current", "600\n");
        write("a/memory.stat", "anon 450\ninactive_file 100\nactive_file 50\n");
        assert_eq!(left("0::/a/b\n"), [550]);
        // Version 1, where the totals include the group's children; the path is not visible from here.
        write("memory/memory.limit_in_bytes", "2000\n");
        write("memory/memory.usage_in_bytes", "2500\n");
        write("memory/memory.stat", "inactive_file 1\ntotal_inactive_file 700\ntotal_active_file 100\n");
        assert_eq!(left("4:memory:/docker/x\n3:cpuset:/\n"), [300]);
        assert_eq!(left("0::/a\n4:cpu,memory:/\n"), [550, 300]);
    }

    #[test]
    fn more_than_there_is_is_refused_with_both_figures() {
        let e = require(1 << 60).err();
        assert_eq!(e.is_some(), room().is_some());
        if let Some(e) = e {
            assert_eq!(e.kind(), ErrorKind::System);
            assert!(e.what().contains("1152921504.61 GB") && e.what().contains("leaves"), "{e}");
        }
        assert!(require(1 << 20).is_ok());
        let e = reserved::<u64>(usize::MAX / 16).unwrap_err();
        assert_eq!(e.kind(), ErrorKind::System);
    }
}
