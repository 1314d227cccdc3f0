//! Routes of CSV files.

use std::path::Path;

use shm_config::file::read_text;
use vehicle::Point;

use super::{ROWS_MAX, Route, RouteError, Row};

/// Longest file, bytes: 80 characters for each row, 8 MB.
const BYTES_MAX: u64 = 80 * ROWS_MAX as u64;

impl Route {
    /// Reads a route of a CSV file with the columns x, y, distance to the right edge and
    /// distance to the left edge, all in metres: the format of the centre lines of F1TENTH's
    /// race tracks. Lines that begin with `#` are skipped.
    ///
    /// # Errors
    /// A file that cannot be read or is longer than 8 MB, a row without four numbers, and
    /// those of [`Route::new`].
    pub fn read_csv(path: &Path, is_closed: bool) -> Result<Self, RouteError> {
        let wrong = |what: String| RouteError::Table {
            path: path.into(),
            what,
        };
        let text = read_text(path, BYTES_MAX).map_err(|error| RouteError::File {
            path: path.into(),
            error,
        })?;
        let mut reader = csv::ReaderBuilder::new()
            .has_headers(false)
            .comment(Some(b'#'))
            .trim(csv::Trim::All)
            .from_reader(text.as_bytes());
        let mut rows = Vec::new();
        for row in reader.deserialize::<(f64, f64, f64, f64)>() {
            let (x_m, y_m, right_m, left_m) = row.map_err(|error| wrong(error.to_string()))?;
            let place = Point::new(x_m, y_m);
            rows.push(Row {
                place,
                left_m,
                right_m,
            });
        }
        Self::new(rows, is_closed).map_err(|error| wrong(error.to_string()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Route, RouteError> {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("track.csv");
        std::fs::write(&path, text).expect("a file");
        Route::read_csv(&path, true)
    }

    #[test]
    fn a_centre_line_of_a_race_track_is_a_route() {
        let track = "# x_m, y_m, w_tr_right_m, w_tr_left_m\n0, 0, 1.1, 1.2\n4,0,1,1\n4,3,1,1\n";
        let route = read(track).expect("a route");
        assert!((route.length_m() - 12.0).abs() < 1e-9);
        let (_, left_m, right_m) = route.at(0.0);
        assert_eq!((left_m, right_m), (1.2, 1.1));
    }

    #[test]
    fn a_file_that_is_too_long_is_refused_in_one_line() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("track.csv");
        let file = std::fs::File::create(&path).expect("a file");
        file.set_len(BYTES_MAX + 1).expect("its length");
        let error = Route::read_csv(&path, true).expect_err("refused");
        let long = error.to_string();
        let rows = (0..=ROWS_MAX).map(|k| format!("{k},0,1,1\n"));
        let many = read(&rows.collect::<String>()).expect_err("refused");
        let many = many.to_string();
        assert!(long.contains("is longer than the 8000000 bytes"), "{long}");
        assert!(many.contains("a route has at most 100,000 rows"), "{many}");
        for error in [long, many] {
            assert!(error.contains("track.csv"), "{error}");
            assert_eq!(error.lines().count(), 1, "{error}");
        }
    }

    #[test]
    fn a_wrong_row_is_named_in_one_line() {
        for text in [
            "",
            "1,2\n",
            "a,b,c,d\n1,2,3,4\n",
            "0,0,1,1\n1,nan,1,1\n",
            "\u{0}",
        ] {
            let error = read(text).expect_err(text).to_string();
            assert!(error.contains("track.csv"), "{error}");
            assert_eq!(error.lines().count(), 1, "{error}");
        }
    }
}
