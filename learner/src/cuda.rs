//! Matrix products on a GPU: a build with `--features learner/cuda`.
//!
//! CUDA's libraries are loaded when the learner starts, so that the build needs
//! none. Each product copies its operands to the GPU and its result back: at the
//! experiment's sizes (256 x 259 by 259 x 256) little is to be gained. It is meant
//! for larger nets and batches.

use std::sync::{Arc, Mutex, OnceLock};

use cudarc::cublas::{CudaBlas, Gemm, GemmConfig, sys::cublasOperation_t};
use cudarc::driver::{CudaContext, CudaStream};

use crate::matrix::{Old, View};

/// The GPU that products are made on: the first one.
const DEVICE: usize = 0;

/// A GPU, ready for products.
struct Gpu {
    stream: Arc<CudaStream>,
    blas: CudaBlas,
}

/// Opened once; the mutex keeps products of several threads one after the other.
static GPU: OnceLock<Mutex<Gpu>> = OnceLock::new();

/// Takes the first GPU: from now on all products of this process are made there.
///
/// # Errors
/// Why there is none, and what to do.
pub fn open() -> Result<(), String> {
    let gpu = take().map_err(|why| {
        format!(
            "no GPU to learn on: {why}; install the driver and cuBLAS of CUDA 12, or build \
             without `--features learner/cuda`"
        )
    })?;
    // Taken before by another thread: one is enough.
    let _ = GPU.set(Mutex::new(gpu));
    Ok(())
}

/// Products are made there.
pub fn is_open() -> bool {
    GPU.get().is_some()
}

fn take() -> Result<Gpu, String> {
    // SAFETY: it only looks for the libraries; the crate panics where it finds none.
    #[allow(unsafe_code)]
    let is_there = unsafe {
        cudarc::driver::sys::is_culib_present() && cudarc::cublas::sys::is_culib_present()
    };
    if !is_there {
        return Err("libcuda or libcublas is not there".into());
    }
    let context = CudaContext::new(DEVICE).map_err(|error| error.to_string())?;
    let stream = context.default_stream();
    let blas = CudaBlas::new(stream.clone()).map_err(|error| error.to_string())?;
    Ok(Gpu { stream, blas })
}

/// `out = a b`, or `out += a b`, as [`crate::matrix::product`] has it.
///
/// # Panics
/// When there is no GPU, or it is lost: the learner is restarted and goes on from
/// its last block.
pub(crate) fn product(out: &mut [f32], old: Old, a: View, b: View) {
    let gpu = GPU.get().expect("a GPU that was opened");
    let gpu = gpu.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
    if let Err(error) = gpu.product(out, old, (a, b)) {
        panic!("the GPU does not answer: {error}");
    }
}

impl Gpu {
    fn product(&self, out: &mut [f32], old: Old, (a, b): (View, View)) -> Result<(), String> {
        let failed = |error: &dyn std::fmt::Display| error.to_string();
        let stream = &self.stream;
        let (rows, columns, inner) = (a.rows(), b.columns(), a.columns());
        let on_gpu = |data: &[f32]| stream.clone_htod(data).map_err(|error| failed(&error));
        let (a_gpu, b_gpu) = (on_gpu(a.data())?, on_gpu(b.data())?);
        let mut out_gpu = match old {
            Old::Add => on_gpu(out)?,
            Old::Replace => stream
                .alloc_zeros(out.len())
                .map_err(|error| failed(&error))?,
        };
        // cuBLAS has columns one after the other: it is asked for the mirrored
        // product, b a, of the mirrored operands.
        let (transa, lda) = layout(&b);
        let (transb, ldb) = layout(&a);
        let sizes = GemmConfig {
            transa,
            transb,
            m: size(columns),
            n: size(rows),
            k: size(inner),
            alpha: 1.0_f32,
            lda,
            ldb,
            beta: match old {
                Old::Add => 1.0,
                Old::Replace => 0.0,
            },
            ldc: size(columns),
        };
        // SAFETY: the sizes are those of the views, which keep each element within
        // its slice, and the copies on the GPU are as long as the slices.
        #[allow(unsafe_code)]
        unsafe { self.blas.gemm(sizes, &b_gpu, &a_gpu, &mut out_gpu) }
            .map_err(|error| failed(&error))?;
        stream
            .memcpy_dtoh(&out_gpu, out)
            .and_then(|()| stream.synchronize())
            .map_err(|error| failed(&error))
    }
}

/// Whether cuBLAS has to mirror a view, and the step between its long lines.
fn layout(view: &View) -> (cublasOperation_t, i32) {
    match view.strides() {
        [row, 1] if row >= view.columns() => (cublasOperation_t::CUBLAS_OP_N, size(row)),
        [_, column] => (cublasOperation_t::CUBLAS_OP_T, size(column)),
    }
}

/// Sizes as cuBLAS counts them; nets and batches are limited far below.
fn size(count: usize) -> i32 {
    i32::try_from(count).expect("a matrix of less than 2^31 rows")
}

#[cfg(test)]
mod tests {
    use super::open;
    use crate::matrix::{Old, View, product};

    /// The definition, element by element; sizes are small enough for it.
    fn by_definition(a: &[f32], b: &[f32], [rows, inner, columns]: [usize; 3]) -> Vec<f32> {
        let element = |k: usize| {
            let (row, column) = (k / columns, k % columns);
            let terms = (0..inner).map(|i| a[row * inner + i] * b[i * columns + column]);
            terms.sum()
        };
        (0..rows * columns).map(element).collect()
    }

    fn mirrored(data: &[f32], rows: usize, columns: usize) -> Vec<f32> {
        let element = |k: usize| data[k % rows * columns + k / rows];
        (0..rows * columns).map(element).collect()
    }

    #[test]
    fn products_are_as_defined_or_it_is_told_that_there_is_no_gpu() {
        if let Err(why) = open() {
            assert!(why.contains("no GPU to learn on"), "{why}");
            assert!(why.contains("--features learner/cuda"), "{why}");
            return;
        }
        for sizes in [[3, 4, 5], [1, 7, 2], [6, 5, 1], [1, 1, 1]] {
            let [rows, inner, columns] = sizes;
            let numbers = |count: usize| (0..count).map(|k| (k as f32).sin()).collect::<Vec<_>>();
            let (a, b) = (numbers(rows * inner), numbers(inner * columns));
            let expected = by_definition(&a, &b, sizes);
            let (a_mirrored, b_mirrored) =
                (mirrored(&a, rows, inner), mirrored(&b, inner, columns));
            let views = [
                (View::new(&a, rows, inner), View::new(&b, inner, columns)),
                (
                    View::new(&a_mirrored, inner, rows).transposed(),
                    View::new(&b_mirrored, columns, inner).transposed(),
                ),
            ];
            for (a, b) in views {
                let mut out = vec![0.5; rows * columns];
                product(&mut out, Old::Replace, a, b);
                product(&mut out, Old::Add, a, b);
                for (found, expected) in out.iter().zip(&expected) {
                    assert!((found - 2.0 * expected).abs() < 1e-4, "{sizes:?}: {out:?}");
                }
            }
        }
    }
}
