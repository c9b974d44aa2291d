//! A folder of results: nothing of the user's is lost, and old and new never mix.

#![allow(clippy::unwrap_used, reason = "a test may panic, its helpers too")]

use std::fs;
use std::io::Write;
use std::path::Path;

use fgs_files::{FolderError, OutputFolder};

fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).into_iter().flatten();
    let mut names: Vec<_> = entries
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .filter(|name| name != ".fgs-files" && (cfg!(unix) || !name.ends_with(".lock")))
        .collect();
    names.sort();
    names
}

fn fill(folder: &Path, files: &[&str]) {
    let claimed = OutputFolder::claim(folder).unwrap();
    let staged = claimed.begin().unwrap();
    for name in files {
        staged.write(name, |file| write!(file, "{name}")).unwrap();
    }
    staged.finish().unwrap();
}

fn foreign(folder: &Path) -> String {
    match OutputFolder::claim(folder).unwrap_err() {
        FolderError::Foreign { entry, .. } => entry.to_str().unwrap().replace('\\', "/"),
        error => panic!("{error}"),
    }
}

#[test]
fn new_contents_take_the_place_of_old_ones() {
    let parent = tempfile::tempdir().unwrap();
    let folder = parent.path().join("a/out");
    fill(&folder, &["x", "pictures/1", "pictures/2"]);
    fill(&folder, &["y", "pictures/3"]);
    assert_eq!(names(&folder), ["pictures", "y"]);
    assert_eq!(names(&folder.join("pictures")), ["3"]);
    assert_eq!(names(&parent.path().join("a")), ["out"]);
    // An empty folder is taken, too.
    let empty = parent.path().join("empty");
    fs::create_dir(&empty).unwrap();
    fill(&empty, &["x"]);
    assert_eq!(names(&empty), ["x"]);
}

#[test]
fn a_folder_that_holds_anything_else_is_refused_and_left_alone() {
    let parent = tempfile::tempdir().unwrap();
    let folder = parent.path().join("out");
    fs::create_dir_all(folder.join("pictures")).unwrap();
    fs::write(folder.join("pictures/mine.png"), "mine").unwrap();
    assert_eq!(foreign(&folder), "pictures/mine.png");
    fs::remove_dir_all(&folder).unwrap();

    fill(&folder, &["x", "pictures/1"]);
    for mine in ["notes", "pictures/notes", "deep/er/notes"] {
        let path = folder.join(mine);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, "mine").unwrap();
        assert_eq!(foreign(&folder), mine);
        fs::remove_file(path).unwrap();
    }
    assert_eq!(foreign(&folder), "deep/er");
    assert_eq!(names(parent.path()), ["out"]);
    assert_eq!(names(&folder), ["deep", "pictures", "x"]);
    // Without the list nothing is known to be ours.
    fs::remove_dir_all(folder.join("deep")).unwrap();
    fs::remove_file(folder.join(".fgs-files")).unwrap();
    assert_eq!(foreign(&folder), "pictures/1");
}

/// A folder of ours may hold another.
#[test]
fn a_folder_of_ours_in_another_goes_with_it() {
    let parent = tempfile::tempdir().unwrap();
    let folder = parent.path().join("out");
    fill(&folder, &["x"]);
    fill(&folder.join("views"), &["1", "2"]);
    fill(&folder, &["y"]);
    assert_eq!(names(&folder), ["y"]);
}

#[test]
fn what_appears_meanwhile_is_kept() {
    let parent = tempfile::tempdir().unwrap();
    let folder = parent.path().join("out");
    fill(&folder, &["x"]);
    let claimed = OutputFolder::claim(&folder).unwrap();
    let staged = claimed.begin().unwrap();
    staged.write("y", |_| Ok(())).unwrap();
    fs::write(folder.join("notes"), "mine").unwrap();
    let error = staged.finish().unwrap_err();
    assert!(matches!(error, FolderError::Foreign { .. }), "{error}");
    assert_eq!(names(&folder), ["notes", "x"]);
    let locks = usize::from(cfg!(unix));
    assert_eq!(names(parent.path()).len(), 1 + locks, "out and its lock");
}

#[test]
fn incomplete_results_go_beside_the_old() {
    let parent = tempfile::tempdir().unwrap();
    let folder = parent.path().join("out");
    fill(&folder, &["x"]);
    let claimed = OutputFolder::claim(&folder).unwrap();
    for beside in ["out-2", "out-3"] {
        let staged = claimed.begin().unwrap();
        assert!(staged.replaces());
        let failed = staged.write("map", |file| {
            file.write_all(b"half")?;
            Err(std::io::ErrorKind::StorageFull.into())
        });
        assert!(failed.is_err());
        staged.write("y", |_| Ok(())).unwrap();
        assert_eq!(
            staged.finish_beside().unwrap().path(),
            parent.path().join(beside)
        );
        assert_eq!(names(&parent.path().join(beside)), ["y"]);
    }
    drop(claimed);
    assert_eq!(names(&folder), ["x"]);
    assert_eq!(names(parent.path()), ["out", "out-2", "out-3"]);
}

#[test]
fn one_writer_at_a_time() {
    let parent = tempfile::tempdir().unwrap();
    let folder = parent.path().join("out");
    let claimed = OutputFolder::claim(&folder).unwrap();
    let error = OutputFolder::claim(&folder).unwrap_err();
    assert!(matches!(error, FolderError::Busy(_)), "{error}");
    let next = OutputFolder::claim_new(parent.path(), "out".as_ref()).unwrap();
    assert_eq!(next.path(), parent.path().join("out-2"));
    drop(claimed);
    OutputFolder::claim(&folder).unwrap();
}

#[test]
fn left_overs_are_removed_and_what_was_set_aside_comes_back() {
    let parent = tempfile::tempdir().unwrap();
    let folder = parent.path().join("out");
    fill(&folder, &["x"]);
    // Killed while writing; after the switch; in the middle of one that takes two steps.
    let claimed = OutputFolder::claim(&folder).unwrap();
    let staged = claimed.begin().unwrap();
    staged.write("pictures/y", |_| Ok(())).unwrap();
    std::mem::forget(staged);
    drop(claimed);
    fill(&parent.path().join("old"), &["z"]);
    fs::rename(
        parent.path().join("old"),
        parent.path().join("out.abcdef.unfinished"),
    )
    .unwrap();
    fs::rename(&folder, parent.path().join("out.ABCDEF.replaced")).unwrap();
    // Killed while removing what was replaced.
    fill(
        &parent.path().join("old"),
        &["pictures/1", "pictures/2", "z"],
    );
    fs::remove_file(parent.path().join("old/pictures/1")).unwrap();
    fs::remove_file(parent.path().join("old/pictures/2")).unwrap();
    fs::rename(
        parent.path().join("old"),
        parent.path().join("out.123456.unfinished"),
    )
    .unwrap();
    // Somebody else's, by their names.
    fs::create_dir(parent.path().join("out.old.unfinished")).unwrap();
    fs::create_dir(parent.path().join("out.ghijkl.unfinished")).unwrap();
    fs::write(parent.path().join("out.ghijkl.unfinished/mine"), "").unwrap();
    assert_eq!(names(parent.path()).len(), 6);
    drop(OutputFolder::claim(&folder).unwrap());
    assert_eq!(
        names(parent.path()),
        ["out", "out.ghijkl.unfinished", "out.old.unfinished"]
    );
    assert_eq!(names(&folder), ["x"]);
}

#[test]
fn an_update_keeps_everything_else() {
    let parent = tempfile::tempdir().unwrap();
    let folder = parent.path().join("out");
    fill(&folder, &["map", "scores", "pictures/1"]);
    fs::write(folder.join("notes"), "mine").unwrap();
    fs::create_dir(folder.join("films")).unwrap();
    fs::write(folder.join("films/1"), "mine").unwrap();
    let claimed = OutputFolder::claim_any(&folder).unwrap();
    let staged = claimed.begin().unwrap();
    staged.carry_over(&["scores", "pictures"]).unwrap();
    staged.write("scores", |file| write!(file, "new")).unwrap();
    staged.finish().unwrap();
    drop(claimed);
    assert_eq!(names(&folder), ["films", "map", "notes", "scores"]);
    assert_eq!(fs::read_to_string(folder.join("scores")).unwrap(), "new");
    assert_eq!(fs::read_to_string(folder.join("films/1")).unwrap(), "mine");
    assert_eq!(names(parent.path()), ["out"]);
    // What is the user's still is.
    assert_eq!(foreign(&folder), "films/1");
}

#[cfg(unix)]
#[test]
fn links_are_followed_and_modes_kept() {
    use std::os::unix::fs::{PermissionsExt, symlink};
    let parent = tempfile::tempdir().unwrap();
    let (real, link) = (parent.path().join("disk/out"), parent.path().join("link"));
    fs::create_dir_all(&real).unwrap();
    fs::set_permissions(&real, PermissionsExt::from_mode(0o750)).unwrap();
    symlink(&real, &link).unwrap();
    fill(&link, &["x"]);
    assert!(link.is_symlink());
    assert_eq!(names(&real), ["x"]);
    assert_eq!(
        fs::metadata(&real).unwrap().permissions().mode() & 0o777,
        0o750
    );
    // What cannot be replaced as a whole.
    for fixed in ["/", "/proc", "."] {
        let error = OutputFolder::claim(Path::new(fixed)).unwrap_err();
        assert!(
            matches!(error, FolderError::Fixed { .. }),
            "{fixed}: {error}"
        );
    }
}
