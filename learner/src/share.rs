//! Shares the work on the parts of a batch between threads.

use std::sync::{Mutex, PoisonError};

/// Processes all items with at most `threads` threads: this one and others of the
/// process's pool. Returns when all items are done.
pub fn share<T: Send>(
    threads: usize,
    items: impl ExactSizeIterator<Item = T> + Send,
    work: impl Fn(T) + Sync,
) {
    let helpers = threads.min(items.len()).saturating_sub(1);
    if helpers == 0 {
        return items.for_each(work);
    }
    let items = Mutex::new(items);
    let help = || {
        // The lock is released before the work begins.
        let next = || items.lock().unwrap_or_else(PoisonError::into_inner).next();
        while let Some(item) = next() {
            work(item);
        }
    };
    rayon::in_place_scope(|scope| {
        for _ in 0..helpers {
            scope.spawn(|_| help());
        }
        help();
    });
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;
    use std::hint::black_box;
    use std::sync::Mutex;
    use std::thread;

    use super::share;

    #[test]
    fn each_item_is_worked_on_once_by_any_number_of_threads() {
        for threads in 0..5 {
            let mut items = [0_u32; 7];
            share(threads, items.iter_mut(), |item| *item += 1);
            assert_eq!(items, [1; 7], "{threads} threads");
        }
    }

    #[test]
    fn no_more_threads_than_allowed_take_part() {
        let seen = Mutex::new(HashSet::new());
        share(2, 0..20, |_| {
            seen.lock().unwrap().insert(thread::current().id());
            black_box((0..100_000_u64).map(black_box).sum::<u64>());
        });
        let seen = seen.into_inner().unwrap();
        assert!(seen.contains(&thread::current().id()));
        assert!(seen.len() <= 2, "{seen:?}");
    }
}
