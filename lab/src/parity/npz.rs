//! Reads the archives of matrices that `numpy.savez` and `savez_compressed` write.
//!
//! An `.npz` file is a zip archive of `.npy` files. Each has a header, a Python dictionary
//! with the element type, the order and the shape, followed by the elements
//! (numpy.lib.format).

use std::io::Read;
use std::path::Path;

use anyhow::{Context, bail, ensure};
use flate2::read::DeflateDecoder;
use rawzip::{CompressionMethod, ZipArchive, ZipSliceArchive};
use serde::Deserialize;

/// The first bytes of an `.npy` file.
const MAGIC: &[u8] = b"\x93NUMPY";

/// An element type of a matrix.
pub trait Element: Sized {
    /// Its name in a header: byte order, kind and size.
    const NAME: &'static str;
    /// The elements of these bytes; `None` if a byte has no meaning or the length is wrong.
    fn read(bytes: &[u8]) -> Option<Vec<Self>>;
}

impl Element for f32 {
    const NAME: &'static str = "<f4";

    fn read(bytes: &[u8]) -> Option<Vec<Self>> {
        let (numbers, rest) = bytes.as_chunks();
        let numbers = numbers.iter().map(|bytes| f32::from_le_bytes(*bytes));
        rest.is_empty().then(|| numbers.collect())
    }
}

impl Element for f64 {
    const NAME: &'static str = "<f8";

    fn read(bytes: &[u8]) -> Option<Vec<Self>> {
        let (numbers, rest) = bytes.as_chunks();
        let numbers = numbers.iter().map(|bytes| f64::from_le_bytes(*bytes));
        rest.is_empty().then(|| numbers.collect())
    }
}

impl Element for bool {
    const NAME: &'static str = "|b1";

    fn read(bytes: &[u8]) -> Option<Vec<Self>> {
        let truth = |byte: &u8| match byte {
            0 => Some(false),
            1 => Some(true),
            _ => None,
        };
        bytes.iter().map(truth).collect()
    }
}

/// The dictionary at the start of an `.npy` file.
#[derive(Deserialize)]
struct Header {
    descr: String,
    fortran_order: bool,
    shape: Vec<usize>,
}

impl Header {
    /// Splits an `.npy` file into its header and the bytes of its elements.
    fn split(file: &[u8]) -> anyhow::Result<(Header, &[u8])> {
        let rest = file.strip_prefix(MAGIC).context("not a numpy array")?;
        let (header, elements) = match *rest {
            [1, _, a, b, ref rest @ ..] => rest.split_at_checked(u16::from_le_bytes([a, b]).into()),
            [2 | 3, _, a, b, c, d, ref rest @ ..] => {
                rest.split_at_checked(u32::from_le_bytes([a, b, c, d]) as usize)
            }
            [1..=3, ..] | [] => None,
            [version, ..] => bail!("version {version} of numpy's format; 1 to 3 are read"),
        }
        .context("the numpy array is cut off in its header")?;
        // The dictionary holds strings, truth values and a tuple of numbers: with these
        // replaced, and without the commas that Python allows before a closing bracket, it
        // is JSON.
        let json: String = std::str::from_utf8(header)
            .context("the header of the numpy array is not text")?
            .replace('\'', "\"")
            .replace('(', "[")
            .replace(')', "]")
            .replace("False", "false")
            .replace("True", "true")
            .split_whitespace()
            .collect();
        let json = json.replace(",]", "]").replace(",}", "}");
        let header = serde_json::from_str(&json).context("the header of the numpy array")?;
        Ok((header, elements))
    }
}

/// An archive of matrices.
pub struct Npz(ZipSliceArchive<Vec<u8>>);

impl Npz {
    /// Reads a file.
    ///
    /// # Errors
    /// If it cannot be read or is not a zip archive.
    pub fn open(path: &Path) -> anyhow::Result<Self> {
        let bytes = std::fs::read(path)?;
        Ok(Self(ZipArchive::from_slice(bytes)?))
    }

    /// The number of columns and the elements, row by row, of a matrix by its name.
    ///
    /// # Errors
    /// If the archive has no such matrix of this element type, or is damaged.
    pub fn matrix<T: Element>(&self, name: &str) -> anyhow::Result<(usize, Vec<T>)> {
        let file = self
            .file(&format!("{name}.npy"))?
            .with_context(|| format!("no array '{name}'"))?;
        parse(&file).with_context(|| format!("array '{name}'"))
    }

    fn file(&self, name: &str) -> anyhow::Result<Option<Vec<u8>>> {
        let mut entries = self.0.entries();
        while let Some(entry) = entries.next_entry()? {
            if entry.file_path().as_bytes() != name.as_bytes() {
                continue;
            }
            let found = self.0.get_entry(entry.wayfinder())?;
            let mut content = Vec::new();
            match entry.compression_method() {
                CompressionMethod::STORE => found
                    .verifying_reader(found.data())
                    .read_to_end(&mut content)?,
                CompressionMethod::DEFLATE => found
                    .verifying_reader(DeflateDecoder::new(found.data()))
                    .read_to_end(&mut content)?,
                other => bail!("'{name}' is compressed by method {other:?}; deflate alone is read"),
            };
            return Ok(Some(content));
        }
        Ok(None)
    }
}

/// The number of columns and the elements, row by row, of an `.npy` file.
fn parse<T: Element>(file: &[u8]) -> anyhow::Result<(usize, Vec<T>)> {
    let (header, bytes) = Header::split(file)?;
    let Header {
        descr,
        fortran_order,
        shape,
    } = header;
    ensure!(descr == T::NAME, "elements are {descr}, not {}", T::NAME);
    ensure!(!fortran_order, "stored by columns, not by rows");
    let (rows, columns) = match shape[..] {
        [rows, columns] if columns > 0 => (rows, columns),
        _ => bail!("the shape is {shape:?}: not a matrix"),
    };
    let elements = T::read(bytes).context("invalid elements")?;
    let count = elements.len();
    ensure!(
        rows.checked_mul(columns) == Some(count),
        "{count} elements, but the shape is {shape:?}"
    );
    Ok((columns, elements))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn npy(header: &str, elements: &[u8]) -> Vec<u8> {
        let mut file = MAGIC.to_vec();
        file.extend([1, 0]);
        file.extend((header.len() as u16).to_le_bytes());
        file.extend(header.as_bytes());
        file.extend(elements);
        file
    }

    const FLAGS: &str = "{'descr': '|b1', 'fortran_order': False, 'shape': (2, 3), }   \n";

    #[test]
    fn a_matrix_is_read_as_numpy_wrote_it() {
        let (columns, flags) = parse::<bool>(&npy(FLAGS, &[0, 1, 0, 1, 1, 0])).expect("a matrix");
        assert_eq!(columns, 3);
        assert_eq!(flags, [false, true, false, true, true, false]);
        let header = "{'descr': '<f4', 'fortran_order': False, 'shape': (1, 2), }";
        let bytes = [1.5_f32.to_le_bytes(), (-2.0_f32).to_le_bytes()].concat();
        let (columns, numbers) = parse::<f32>(&npy(header, &bytes)).expect("a matrix");
        assert_eq!((columns, numbers), (2, vec![1.5, -2.0]));
    }

    #[test]
    fn anything_else_is_refused_with_the_reason() {
        let whole = npy(FLAGS, &[0; 6]);
        let by_columns = FLAGS.replace("False", "True");
        let vector = FLAGS.replace("(2, 3)", "(6,)");
        let no_columns = FLAGS.replace("(2, 3)", "(2, 0)");
        let huge = FLAGS.replace("(2, 3)", "(9223372036854775807, 3)");
        let files = [
            (Vec::new(), "not a numpy array"),
            (whole[..9].to_vec(), "cut off"),
            (whole[..40].to_vec(), "cut off"),
            (b"\x93NUMPY\x04\x00\x00\x00".to_vec(), "version 4"),
            (whole[..whole.len() - 1].to_vec(), "5 elements"),
            (npy(FLAGS, &[2; 6]), "invalid elements"),
            (npy(&by_columns, &[0; 6]), "by columns"),
            (npy(&vector, &[0; 6]), "not a matrix"),
            (npy(&no_columns, &[]), "not a matrix"),
            (npy(&huge, &[0; 6]), "6 elements"),
            (npy("{'descr': 1}", &[]), "header"),
        ];
        for (file, reason) in files {
            let error = parse::<bool>(&file).expect_err(reason);
            assert!(format!("{error:#}").contains(reason), "{error:#}");
        }
        let error = parse::<f64>(&whole).expect_err("another type");
        assert!(error.to_string().contains("|b1, not <f8"), "{error}");
    }
}
