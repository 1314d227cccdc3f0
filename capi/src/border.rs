//! The functions of the C interface. No panic passes them; NULL and wrong lengths are
//! errors.
//!
//! The membership belongs to the thread that joined, and ports are numbers in it. So a
//! stale or foreign handle is an error and never a dangling pointer.
#![allow(unsafe_code)]

use std::any::Any;
use std::cell::RefCell;
use std::ffi::{CStr, CString, c_char, c_int, c_void};
use std::mem::{ManuallyDrop, MaybeUninit};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::slice;
use std::sync::OnceLock;

use shm_config::layout::Layout;
use shm_config::message::{Observation, Plan, Progress};
use shm_config::text::printable;

use crate::description;
use crate::failure::{Answer, Failure, Kind};
use crate::port::{Place, Use};
use crate::session::Session;
use crate::world::Tick;

/// Most arguments of a program that are read; the supervisor gives less than ten.
const ARGUMENTS_MAX: c_int = 256;

thread_local! {
    /// Not dropped with the thread: the library of the wire has thread-locals of its
    /// own, which may be gone by then. The supervisor removes what is left.
    static SESSION: RefCell<ManuallyDrop<Option<Session>>> =
        const { RefCell::new(ManuallyDrop::new(None)) };
    /// Not dropped either: an exit handler may still call, after the thread-locals are gone.
    static ERROR: RefCell<ManuallyDrop<CString>> = RefCell::default();
}

fn note(text: &str) {
    // It may repeat an argument; without control characters there is no zero byte.
    let text = CString::new(printable(text).as_bytes()).unwrap_or_default();
    ERROR.with_borrow_mut(|error| **error = text);
}

fn panic_text(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<&str>().copied();
    let text = text.or_else(|| panic.downcast_ref::<String>().map(String::as_str));
    text.unwrap_or("without a text")
}

/// Runs a call; a failure and a panic become a negative number and a text.
fn guard(call: impl FnOnce() -> Result<i64, Failure>) -> i64 {
    let failure = match catch_unwind(AssertUnwindSafe(call)) {
        Ok(Ok(answer)) => return answer,
        Ok(Err(failure)) => failure,
        Err(panic) => {
            // What it left half done is not used again.
            SESSION.with(|session| {
                if let Ok(mut session) = session.try_borrow_mut() {
                    std::mem::forget(session.take());
                }
            });
            Failure {
                kind: Kind::Panicked,
                text: format!("a defect of libvlaps: {}", panic_text(panic.as_ref())),
            }
        }
    };
    note(&failure.text);
    i64::from(failure.code())
}

/// Runs a call that needs the membership.
fn within(call: impl FnOnce(&mut Session) -> Result<i64, Failure>) -> i64 {
    guard(|| {
        SESSION.with_borrow_mut(|session| match session.as_mut() {
            Some(session) => {
                session.check_process()?;
                call(session)
            }
            None => Err(Failure::invalid(
                "this thread has not joined a run; vlaps_join comes first",
            )),
        })
    })
}

fn code(answer: Answer) -> Result<i64, Failure> {
    Ok(i64::from(answer.code()))
}

/// # Safety
/// NULL, or a text that ends with a zero byte and outlives the call.
unsafe fn text<'a>(name: &str, text: *const c_char) -> Result<&'a str, Failure> {
    if text.is_null() {
        return Err(Failure::invalid(format!("{name} is NULL")));
    }
    // SAFETY: not NULL; the rest is the caller's promise.
    let text = unsafe { CStr::from_ptr(text) };
    text.to_str()
        .map_err(|_| Failure::invalid(format!("{name} is not UTF-8")))
}

/// # Safety
/// NULL, or memory of that many bytes that outlives the call.
unsafe fn bytes<'a>(message: *const c_void, count: usize) -> Result<&'a [u8], Failure> {
    if message.is_null() || count > isize::MAX as usize {
        return Err(Failure::invalid(
            "the message is NULL or has no such length",
        ));
    }
    // SAFETY: not NULL and not too long; the rest is the caller's promise.
    Ok(unsafe { slice::from_raw_parts(message.cast(), count) })
}

/// # Safety
/// NULL, or memory of that many bytes that outlives the call and is used by no other.
unsafe fn place<'a>(message: *mut c_void, count: usize) -> Result<Place<'a>, Failure> {
    if message.is_null() || count > isize::MAX as usize {
        return Err(Failure::invalid(
            "the message is NULL or has no such length",
        ));
    }
    // SAFETY: not NULL and not too long; the rest is the caller's promise.
    Ok(unsafe { slice::from_raw_parts_mut(message.cast::<MaybeUninit<u8>>(), count) })
}

/// # Safety
/// NULL, or `count` texts as of [`text`].
unsafe fn words(count: c_int, words: *const *const c_char) -> Result<Vec<String>, Failure> {
    if words.is_null() || !(0..=ARGUMENTS_MAX).contains(&count) {
        return Err(Failure::invalid(format!(
            "argv is NULL or argc = {count} is outside 0..={ARGUMENTS_MAX}"
        )));
    }
    // SAFETY: not NULL; argv has argc entries by the caller's promise.
    let words = unsafe { slice::from_raw_parts(words, count as usize) };
    // SAFETY: each entry is a text by the same promise.
    let word = |word: &*const c_char| unsafe { text("argv", *word) };
    words
        .iter()
        .map(|each| Ok(word(each)?.to_string()))
        .collect()
}

/// The text of the last failure of this thread.
#[unsafe(no_mangle)]
pub extern "C" fn vlaps_last_error() -> *const c_char {
    ERROR.with_borrow(|error| error.as_ptr())
}

/// The layout hash of this library.
#[unsafe(no_mangle)]
pub extern "C" fn vlaps_layout() -> u64 {
    description::layout()
}

/// Messages, lists and services as JSON.
#[unsafe(no_mangle)]
pub extern "C" fn vlaps_describe() -> *const c_char {
    static JSON: OnceLock<CString> = OnceLock::new();
    JSON.get_or_init(|| CString::new(description::json().to_string()).unwrap_or_default())
        .as_ptr()
}

/// Joins a run.
///
/// # Safety
/// `process` and `argc` entries of `argv` are NULL or texts that end with a zero byte.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vlaps_join_as(
    layout: u64,
    process: *const c_char,
    argc: c_int,
    argv: *const *const c_char,
) -> c_int {
    let joined = guard(|| {
        // SAFETY: the caller's promise.
        let (process, words) = unsafe { (text("process", process)?, words(argc, argv)?) };
        let session = Session::join(layout, process, &words)?;
        SESSION.with_borrow_mut(|place| **place = Some(session));
        code(Answer::Ok)
    });
    joined as c_int
}

/// Leaves the run.
#[unsafe(no_mangle)]
pub extern "C" fn vlaps_leave() -> c_int {
    let left = guard(|| {
        let session = SESSION.with_borrow_mut(|session| session.take());
        if let Some(mut session) = session {
            if let Err(failure) = session.check_process() {
                // The ports are the parent's: closing them would remove them there.
                std::mem::forget(session);
                return Err(failure);
            }
            session.finish();
        }
        code(Answer::Ok)
    });
    left as c_int
}

/// Opens a port; returns its number.
///
/// # Safety
/// `service` is NULL or a text that ends with a zero byte.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vlaps_open(service: *const c_char, with: u32) -> c_int {
    let opened = within(|session| {
        // SAFETY: the caller's promise.
        let service = unsafe { text("service", service)? };
        let with = Use::from_code(with)
            .ok_or_else(|| Failure::invalid(format!("use = {with} is not on its list")))?;
        Ok(session.open(service, with)? as i64)
    });
    opened as c_int
}

/// Closes a port.
#[unsafe(no_mangle)]
pub extern "C" fn vlaps_close(port: c_int) -> c_int {
    within(|session| {
        session.close(number(port)?)?;
        code(Answer::Ok)
    }) as c_int
}

fn number(port: c_int) -> Result<usize, Failure> {
    usize::try_from(port).map_err(|_| Failure::invalid(format!("port {port} is not open")))
}

/// Copies the newest admissible message.
///
/// # Safety
/// `message` is NULL or memory of `count` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vlaps_newest(port: c_int, message: *mut c_void, count: usize) -> c_int {
    within(|session| {
        // SAFETY: the caller's promise.
        let place = unsafe { place(message, count)? };
        code(session.newest(number(port)?, place)?)
    }) as c_int
}

/// Copies the next admissible message of a queue.
///
/// # Safety
/// As [`vlaps_newest`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vlaps_next(port: c_int, message: *mut c_void, count: usize) -> c_int {
    within(|session| {
        // SAFETY: the caller's promise.
        let place = unsafe { place(message, count)? };
        code(session.next(number(port)?, place)?)
    }) as c_int
}

/// Checks a message and publishes it.
///
/// # Safety
/// As [`vlaps_newest`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vlaps_publish(port: c_int, message: *const c_void, count: usize) -> c_int {
    within(|session| {
        // SAFETY: the caller's promise.
        let message = unsafe { bytes(message, count)? };
        session.publish(number(port)?, message)?;
        code(Answer::Ok)
    }) as c_int
}

/// Checks a message.
///
/// # Safety
/// As [`vlaps_newest`]; `service` is NULL or a text that ends with a zero byte.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vlaps_admit(
    service: *const c_char,
    message: *const c_void,
    count: usize,
) -> c_int {
    within(|session| {
        // SAFETY: the caller's promise.
        let (service, message) = unsafe { (text("service", service)?, bytes(message, count)?) };
        session.admit(service, message)?;
        code(Answer::Ok)
    }) as c_int
}

/// Waits for a message.
#[unsafe(no_mangle)]
pub extern "C" fn vlaps_wait(limit_ns: u64) -> c_int {
    within(|session| code(session.wait(limit_ns))) as c_int
}

/// The process id of a process of the run.
///
/// # Safety
/// `process` is NULL or a text that ends with a zero byte.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vlaps_pid_of(process: *const c_char) -> i64 {
    within(|session| {
        // SAFETY: the caller's promise.
        let process = unsafe { text("process", process)? };
        Ok(i64::from(session.pid_of(process)?))
    })
}

/// The machine's clock, ns.
#[unsafe(no_mangle)]
pub extern "C" fn vlaps_now_ns() -> u64 {
    let now = within(|session| Ok(i64::try_from(session.now().0).unwrap_or(i64::MAX)));
    u64::try_from(now).unwrap_or(0)
}

/// Whether the run is in lockstep.
#[unsafe(no_mangle)]
pub extern "C" fn vlaps_is_lockstep() -> c_int {
    within(|session| Ok(i64::from(session.is_lockstep()))) as c_int
}

/// A number of the configuration.
///
/// # Safety
/// `key` is NULL or a text that ends with a zero byte; `value` is NULL or a double.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vlaps_setting(key: *const c_char, value: *mut f64) -> c_int {
    within(|session| {
        // SAFETY: the caller's promise.
        let (key, place) = unsafe { (text("key", key)?, place(value.cast(), size_of::<f64>())?) };
        place.write_copy_of_slice(&session.setting(key)?.to_ne_bytes());
        code(Answer::Ok)
    }) as c_int
}

/// Where the beams of the run's scanner look, into an observation and an array.
///
/// # Safety
/// `observation` is NULL or an observation; `directions_rad` is NULL or has `count` doubles.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vlaps_beams(
    observation: *mut c_void,
    directions_rad: *mut f64,
    count: usize,
) -> c_int {
    within(|session| {
        let size = size_of::<Observation>();
        // SAFETY: the caller's promise.
        let shown = unsafe { bytes(observation, size)? };
        let mut shown = Observation::from_bytes(shown)
            .ok_or_else(|| Failure::invalid("observation: wrong length"))?;
        let fan = session.show_scanner(&mut shown);
        if count < fan.beams {
            return Err(Failure::invalid(format!(
                "scanner.beams is {}, and there is room for {count} directions",
                fan.beams
            )));
        }
        // SAFETY: the caller's promise.
        let (place, directions) = unsafe {
            (
                place(observation, size)?,
                place(directions_rad.cast(), fan.beams * size_of::<f64>())?,
            )
        };
        for (beam, direction) in directions.chunks_exact_mut(size_of::<f64>()).enumerate() {
            direction.write_copy_of_slice(&fan.angle_rad(beam).to_ne_bytes());
        }
        place.write_copy_of_slice(shown.as_bytes());
        code(Answer::Ok)
    }) as c_int
}

/// Waits for the world's next tick.
///
/// # Safety
/// `tick` is NULL or a tick.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vlaps_await_tick(tick: *mut c_void) -> c_int {
    within(|session| {
        // SAFETY: the caller's promise.
        let place = unsafe { place(tick, size_of::<Tick>())? };
        let Some(tick) = session.await_tick()? else {
            return code(Answer::Ended);
        };
        place.write_copy_of_slice(tick.as_bytes());
        code(Answer::Ok)
    }) as c_int
}

/// Answers the world's tick.
///
/// # Safety
/// Both are NULL or the messages that they are named after.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vlaps_finish_tick(
    observation: *const c_void,
    progress: *const c_void,
) -> c_int {
    within(|session| {
        // SAFETY: the caller's promise.
        let (observation, progress) = unsafe {
            (
                bytes(observation, size_of::<Observation>())?,
                bytes(progress, size_of::<Progress>())?,
            )
        };
        code(session.finish_tick(observation, progress)?)
    }) as c_int
}

/// Waits for the next observation at which the planner has its turn.
///
/// # Safety
/// `observation` is NULL or an observation.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vlaps_await_observation(observation: *mut c_void) -> c_int {
    within(|session| {
        // SAFETY: the caller's promise.
        let place = unsafe { place(observation, size_of::<Observation>())? };
        let Some(observation) = session.await_observation()? else {
            return code(Answer::Ended);
        };
        place.write_copy_of_slice(observation.as_bytes());
        code(Answer::Ok)
    }) as c_int
}

/// Publishes the plan of that observation.
///
/// # Safety
/// `plan` is NULL or a plan.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vlaps_answer(plan: *const c_void) -> c_int {
    within(|session| {
        // SAFETY: the caller's promise.
        let plan = unsafe { bytes(plan, size_of::<Plan>())? };
        session.answer(plan)?;
        code(Answer::Ok)
    }) as c_int
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_becomes_a_number_and_a_text() {
        let answer = guard(|| panic!("the number {}", 7));
        assert_eq!(answer, -i64::from(Kind::Panicked.code()));
        let text = ERROR.with_borrow(|error| error.to_string_lossy().into_owned());
        assert_eq!(text, "a defect of libvlaps: the number 7");
        assert_eq!(guard(|| Ok(5)), 5, "the thread goes on");
    }

    #[test]
    fn control_characters_of_a_text_are_shown() {
        note("a\0b\x1b\n");
        let text = ERROR.with_borrow(|error| error.to_string_lossy().into_owned());
        assert_eq!(text, "a\\u{0}b\\u{1b}\\u{a}");
    }
}
