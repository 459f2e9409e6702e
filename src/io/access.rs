//! Access rights of a file that replaces another.

use std::fs::File;
use std::io;

/// Copies owner, group, mode and access list of the replaced file, as far as the system allows. Nobody gets more rights
/// than before.
///
/// # Errors
/// The system's error, if rights cannot be read or set.
#[cfg(unix)]
pub(super) fn keep(old: &File, new: &File) -> io::Result<()> {
    use std::fs::Permissions;
    use std::os::unix::fs::{MetadataExt, PermissionsExt, fchown};
    let (was, is) = (old.metadata()?, new.metadata()?);
    // Group first: once the owner is changed, this process may no longer change the group.
    let group = is.gid() == was.gid() || fchown(new, None, Some(was.gid())).is_ok();
    let owner = is.uid() == was.uid() || fchown(new, Some(was.uid()), None).is_ok();
    let mode = match list_kept(old, new, owner && group)? {
        true => mode_kept(was.mode(), owner, group),
        false => was.mode() & 0o700,
    };
    if new.metadata()?.mode() & 0o7777 == mode { Ok(()) } else { new.set_permissions(Permissions::from_mode(mode)) }
}

/// Other systems give a new file the rights of its folder.
#[cfg(not(unix))]
pub(super) fn keep(_: &File, _: &File) -> io::Result<()> {
    Ok(())
}

/// Reduces a mode if owner or group could not be kept: the old owner is now among group or others, and the new group
/// was among others.
#[cfg(unix)]
fn mode_kept(mode: u32, owner: bool, group: bool) -> u32 {
    let [of_owner, mut of_group, mut of_others] = [6, 3, 0].map(|shift| (mode >> shift) & 0o7);
    if !group {
        (of_group, of_others) = (of_group & of_others, of_group & of_others);
    }
    if !owner {
        (of_group, of_others) = (of_group & of_owner, of_others & of_owner);
    }
    (of_owner << 6) | (of_group << 3) | of_others
}

/// Copies the access list (POSIX ACL), or removes the one inherited from the folder. Returns false if there was a list
/// and it cannot be kept.
#[cfg(target_os = "linux")]
fn list_kept(old: &File, new: &File, same_owners: bool) -> io::Result<bool> {
    use rustix::fs::{XattrFlags, fgetxattr, fremovexattr, fsetxattr};
    use rustix::io::Errno;
    const LIST: &str = "system.posix_acl_access";
    let none = |e: &Errno| [Errno::NODATA, Errno::OPNOTSUPP].contains(e);
    let remove = || match fremovexattr(new, LIST) {
        Err(e) if !none(&e) => Err(io::Error::from(e)),
        _ => Ok(()),
    };
    let mut list = vec![0; 1 << 16];
    let length = match fgetxattr(old, LIST, list.as_mut_slice()) {
        Ok(length) => length,
        Err(e) if none(&e) => return remove().map(|()| true),
        Err(e) => return Err(e.into()),
    };
    if same_owners && fsetxattr(new, LIST, &list[..length], XattrFlags::empty()).is_ok() {
        return Ok(true);
    }
    remove().map(|()| false)
}

/// Access lists of other systems are ignored.
#[cfg(all(unix, not(target_os = "linux")))]
fn list_kept(_: &File, _: &File, _: bool) -> io::Result<bool> {
    Ok(true)
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn nobody_gets_more_rights_than_before() {
        for (mode, owner, group, expected) in [
            (0o100640, true, true, 0o640),
            (0o4755, true, true, 0o755),
            // Another group: it was among others, and the old group is now.
            (0o664, true, false, 0o644),
            (0o640, true, false, 0o600),
            (0o604, true, false, 0o600),
            // Another owner: the old owner is now among group or others.
            (0o644, false, true, 0o644),
            (0o277, false, true, 0o222),
            (0o246, false, false, 0o200),
        ] {
            assert_eq!(mode_kept(mode, owner, group), expected, "{mode:o} {owner} {group}");
        }
    }

    /// The list allows user 4711 to read and write, but not the group.
    #[cfg(target_os = "linux")]
    #[test]
    fn lists_of_others_rights_are_kept_and_none_comes_from_the_folder() {
        use crate::io::atomic::write_atomically;
        use rustix::fs::{XattrFlags, getxattr, removexattr, setxattr};
        use std::fs::{self, Permissions};
        use std::io::Write;
        use std::os::unix::fs::PermissionsExt;
        const LIST: &str = "system.posix_acl_access";
        let entries =
            [(1u16, 6u16, u32::MAX), (2, 6, 4711), (4, 0, u32::MAX), (0x10, 6, u32::MAX), (0x20, 0, u32::MAX)];
        let mut list = 2u32.to_le_bytes().to_vec();
        for (tag, rights, id) in entries {
            list.extend([tag.to_le_bytes(), rights.to_le_bytes()].concat());
            list.extend(id.to_le_bytes());
        }
        let read = |path: &std::path::Path| {
            let mut bytes = [0; 100];
            getxattr(path, LIST, bytes.as_mut_slice()).ok().map(|length| bytes[..length].to_vec())
        };
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        fs::write(&path, b"old").unwrap();
        if setxattr(&path, LIST, &list, XattrFlags::empty()).is_err() {
            eprintln!("skipped: this file system keeps no access lists");
            return;
        }
        let write = || write_atomically(&path, |f| f.write_all(b"new")).unwrap();
        write();
        assert_eq!(read(&path), Some(list.clone()));
        removexattr(&path, LIST).unwrap();
        fs::set_permissions(&path, Permissions::from_mode(0o660)).unwrap();
        setxattr(folder.path(), "system.posix_acl_default", &list, XattrFlags::empty()).unwrap();
        write();
        assert_eq!((read(&path), fs::metadata(&path).unwrap().permissions().mode() & 0o777), (None, 0o660));
    }
}
