//! A simulator's checkout, which the user made of its repository.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use sha2::{Digest, Sha256};

use crate::cli::failure::Failure;
use crate::setup::foreign::Source;

/// Not of the package: MetaDrive's models, which are not used without a screen (its
/// `check.py` writes a stub), and files that Python creates itself.
const LEFT_OUT: [&str; 2] = ["assets", "__pycache__"];

/// A checkout in its present state.
#[derive(Debug)]
pub struct Checkout {
    folder: PathBuf,
    /// The files of its package, relative to the folder, in order.
    files: Vec<PathBuf>,
    identity: String,
}

impl Checkout {
    /// Reads a checkout.
    ///
    /// # Errors
    /// When it is of another repository, or cannot be read.
    pub fn open(source: &Source, folder: &Path) -> Result<Checkout, Failure> {
        if !folder.join(source.landmark).is_file() {
            return Err(Failure::Usage(format!(
                "--checkout {}: {} is missing; name the folder that git clone made of {}",
                folder.display(),
                source.landmark,
                source.address
            )));
        }
        let mut files = Vec::new();
        list(folder, Path::new(source.package), &mut files)?;
        files.sort();
        let mut digest = Sha256::new();
        for file in &files {
            let content = read(fs::read(folder.join(file)), file)?;
            digest.update(file.as_os_str().as_encoded_bytes());
            digest.update((content.len() as u64).to_le_bytes());
            digest.update(content);
        }
        let digest: String = (digest.finalize().iter().take(8))
            .map(|byte| format!("{byte:02x}"))
            .collect();
        let commit = commit(folder).map_or(String::new(), |commit| format!("commit {commit}, "));
        Ok(Checkout {
            folder: read(folder.canonicalize(), folder)?,
            files,
            identity: format!("{commit}files {digest}"),
        })
    }

    /// Where it is.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Its commit, if git knows it, and a digest of the files of its package.
    pub fn identity(&self) -> &str {
        &self.identity
    }

    /// Copies it to the installed packages; the folder of an earlier one must have been
    /// removed.
    ///
    /// # Errors
    /// When a file cannot be copied.
    pub fn copy_into(&self, packages: &Path) -> Result<(), Failure> {
        for file in &self.files {
            let to = packages.join(file);
            let made = to.parent().map_or(Ok(()), fs::create_dir_all);
            read(made, &to)?;
            read(fs::copy(self.folder.join(file), &to), &to)?;
        }
        Ok(())
    }
}

/// All files below a folder; links to folders are not followed.
fn list(root: &Path, below: &Path, files: &mut Vec<PathBuf>) -> Result<(), Failure> {
    for entry in read(fs::read_dir(root.join(below)), below)? {
        let entry = read(entry, below)?;
        let path = below.join(entry.file_name());
        if LEFT_OUT.iter().any(|name| entry.file_name() == *name) {
            continue;
        }
        if read(entry.file_type(), &path)?.is_dir() {
            list(root, &path, files)?;
        } else if entry.path().is_file() {
            files.push(path);
        }
    }
    Ok(())
}

fn read<T>(result: std::io::Result<T>, path: &Path) -> Result<T, Failure> {
    result.map_err(|error| Failure::GivenUp(format!("{}: {error}", path.display())))
}

/// The commit that is checked out; `None` for an unpacked archive.
fn commit(folder: &Path) -> Option<String> {
    // Without this option git would use the commit of a repository around the folder.
    if !folder.join(".git").exists() {
        return None;
    }
    let mut git = Command::new("git");
    let output = git.arg("-C").arg(folder).args(["rev-parse", "HEAD"]);
    let output = output.output().ok()?;
    let commit = String::from_utf8(output.stdout).ok()?;
    Some(commit.trim().to_string()).filter(|commit| !commit.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::setup::foreign::{METADRIVE, Origin};

    const SOURCE: Source = match METADRIVE.origin {
        Origin::PackageOrCopy(source) => source,
        _ => panic!("copied"),
    };
    const LANDMARK: &str = SOURCE.landmark;

    fn checkout(folder: &Path) {
        for (file, text) in [
            (LANDMARK, "class SafeMetaDriveEnv: pass"),
            ("metadrive/version.py", "VERSION = '1'"),
            ("metadrive/assets/version.txt", "1"),
            ("metadrive/envs/__pycache__/x.pyc", "x"),
            ("setup.py", ""),
        ] {
            let path = folder.join(file);
            fs::create_dir_all(path.parent().expect("a folder")).expect("room");
            fs::write(path, text).expect("room");
        }
    }

    #[test]
    fn a_folder_that_is_not_metadrive_is_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        let error = Checkout::open(&SOURCE, folder.path()).expect_err("empty");
        assert!(error.to_string().contains("is missing"));
        // The folder of the package itself, one level too deep.
        checkout(folder.path());
        Checkout::open(&SOURCE, &folder.path().join("metadrive")).expect_err("the package itself");
    }

    #[test]
    fn the_package_is_copied_without_assets_and_a_change_is_seen() {
        let (from, to) = (tempfile::tempdir(), tempfile::tempdir());
        let (from, to) = (from.expect("a folder"), to.expect("a folder"));
        checkout(from.path());
        let before = Checkout::open(&SOURCE, from.path()).expect("MetaDrive");
        before.copy_into(to.path()).expect("room");
        assert!(to.path().join(LANDMARK).is_file());
        assert!(to.path().join("metadrive/version.py").is_file());
        for absent in ["metadrive/assets", "metadrive/envs/__pycache__", "setup.py"] {
            assert!(!to.path().join(absent).exists(), "{absent}");
        }
        let again = Checkout::open(&SOURCE, from.path()).expect("MetaDrive");
        assert_eq!(before.identity(), again.identity());
        fs::write(from.path().join("metadrive/version.py"), "VERSION = '2'").expect("room");
        let after = Checkout::open(&SOURCE, from.path()).expect("MetaDrive");
        assert_ne!(before.identity(), after.identity());
    }
}
