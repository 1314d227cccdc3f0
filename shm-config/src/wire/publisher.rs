//! The publishing end of a service.

use std::mem::MaybeUninit;
use std::ptr;
use std::rc::Rc;

use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::sample_mut::SampleMut;
use iceoryx2::sample_mut_uninit::SampleMutUninit;
use iceoryx2::service::header::publish_subscribe::Header as SampleHeader;
use rustix::io::Errno;
use rustix::mm::{Advice, madvise};

use super::Ipc;
use crate::message::{
    Camera, FRAME_BYTES_MAX, Frame, Header, Message, PixelFormat, WEIGHTS_BYTES_MAX, Weights,
};

type Port<M> = iceoryx2::port::publisher::Publisher<Ipc, M, ()>;
type Loan<M> = SampleMutUninit<Ipc, MaybeUninit<M>, ()>;

/// The largest message whose sample is loaned before it is needed, bytes. A larger one has
/// its memory from the first time that it is sent.
const LOANED_EARLY_MAX: usize = 1 << 20;

/// Publishes one service and wakes its readers.
pub struct Publisher<M: Message> {
    /// The sample of the next message, loaned between ticks: the library allocates
    /// a handle for each loan.
    loaned: Option<Loan<M>>,
    port: Port<M>,
    bells: Vec<Rc<Notifier<Ipc>>>,
    sequence: u64,
    producer: u32,
    /// The most bytes of a message that were ever sent.
    used: usize,
}

impl<M: Message> Publisher<M> {
    /// A publisher on an open port, with the doorbells of its readers.
    pub(super) fn new(port: Port<M>, bells: Vec<Rc<Notifier<Ipc>>>) -> Self {
        Self {
            loaned: loan_early(&port),
            port,
            bells,
            sequence: 0,
            producer: std::process::id(),
            used: 0,
        }
    }

    /// Numbers the message, publishes it and wakes its readers. It never blocks and
    /// never waits for a reader. Returns whether the message was sent; only exhausted
    /// shared memory prevents that, and the next message tries again.
    pub fn send(&mut self, message: &mut M) -> bool {
        let sent = self.send_quietly(message);
        for bell in &self.bells {
            // A full bell is already ringing; another process sweeps a dead one.
            let _ = bell.notify();
        }
        sent
    }

    /// As [`Publisher::send`], without waking a reader.
    pub fn send_quietly(&mut self, message: &mut M) -> bool {
        self.sequence += 1;
        let (sequence, producer) = (self.sequence, self.producer);
        let header = message.header_mut();
        header.sequence = sequence;
        header.producer = producer;
        self.used = self.used.max(message.used_bytes());
        let sample = self.loaned.take().or_else(|| loan(&self.port));
        sample.is_some_and(|sample| written(sample, message, self.used).send().is_ok())
    }

    /// Publishes a message of another machine with the number and the producer that it has,
    /// so that its readers count what was lost on the way, and wakes them. Returns as
    /// [`Publisher::send`].
    pub fn pass_on(&mut self, message: &M) -> bool {
        self.used = self.used.max(message.used_bytes());
        let sample = self.loaned.take().or_else(|| loan(&self.port));
        let sent = sample.is_some_and(|sample| written(sample, message, self.used).send().is_ok());
        for bell in &self.bells {
            let _ = bell.notify();
        }
        sent
    }

    /// Connects to readers that came since the last message, gives them the
    /// history, and loans the sample of the next message. To be called between
    /// ticks, so that no tick pays for it.
    pub fn update_connections(&mut self) {
        // A failure here appears again at the next send.
        let _ = self.port.update_connections();
        if self.loaned.is_none() {
            self.loaned = loan_early(&self.port);
        }
    }
}

/// A sample for the next message; `None` when there is no memory for all of it.
fn loan<M: Message>(port: &Port<M>) -> Option<Loan<M>> {
    let mut sample = port.loan_uninit().ok()?;
    // The library writes a header when it loans a sample, before memory can be asked for: that
    // of the sample behind this one is asked for here.
    let bytes = size_of::<M>() + size_of::<SampleHeader>();
    let given = populate(sample.payload_mut().as_mut_ptr().cast(), bytes);
    // Any other error, as of a kernel before 5.14 or a filter of system calls, says nothing of
    // the memory.
    let is_missing = matches!(given, Err(Errno::FAULT | Errno::NOMEM | Errno::HWPOISON));
    (!is_missing).then_some(sample)
}

/// The same, unless the message is large and may never be sent.
fn loan_early<M: Message>(port: &Port<M>) -> Option<Loan<M>> {
    (size_of::<M>() <= LOANED_EARLY_MAX)
        .then(|| loan(port))
        .flatten()
}

/// Gives these bytes of a mapped file all their memory now. A file in /dev/shm has memory
/// where it was written or read: when all memory is taken, the first access to another page
/// ends the process with SIGBUS, its reader, too. Here it is an error.
fn populate(begin: *mut u8, bytes: usize) -> rustix::io::Result<()> {
    let before = begin.addr() % rustix::param::page_size();
    let page = begin.wrapping_sub(before).cast();
    // SAFETY: the advice changes no byte, and is refused outside a mapping. A mapping begins
    // with a page, so the first page is one of the same mapping; behind the last sample the
    // library keeps its list of free ones, which is longer than a header.
    #[allow(unsafe_code)]
    unsafe {
        madvise(page, before + bytes, Advice::LinuxPopulateWrite)
    }
}

/// Writes the first `used` bytes of the message, and no others: 2,048 beams of which a
/// scanner has 240 cost a world at 100 Hz, whose caches are cold, several microseconds.
fn written<M: Message>(mut sample: Loan<M>, message: &M, used: usize) -> SampleMut<Ipc, M, ()> {
    let used = used.min(size_of::<M>());
    // SAFETY: both pointers are to a whole `M`, of which `used` bytes are at most all; the
    // sample's payload is ours alone until it is sent. The other bytes of the payload were
    // never written, because `used` never decreases: they are the zeros with which the
    // system made this publisher's memory. A message consists of numbers alone
    // (`layout::Travels`), so that these bytes are one.
    #[allow(unsafe_code)]
    unsafe {
        let payload = sample.payload_mut().as_mut_ptr();
        ptr::copy_nonoverlapping(ptr::from_ref(message).cast::<u8>(), payload.cast(), used);
        sample.assume_init()
    }
}

impl<M: Message> Publisher<M> {
    /// Publishes a message that is written in place, over zeros: megabytes do not
    /// belong on a stack. Returns whether it was sent.
    fn send_written(&mut self, write: impl FnOnce(&mut M)) -> bool
    where
        M: Numbers,
    {
        self.sequence += 1;
        let (sequence, producer) = (self.sequence, self.producer);
        self.used = size_of::<M>();
        let sample = self.loaned.take().or_else(|| loan(&self.port));
        let Some(mut sample) = sample else {
            return false;
        };
        // SAFETY: the pointer is to the sample's payload, which is ours alone until
        // it is sent; `Numbers` is only said of messages made of numbers and arrays
        // of them, so all zeros are one, and the rest is written over it.
        #[allow(unsafe_code)]
        let sample = unsafe {
            let payload = sample.payload_mut().as_mut_ptr();
            payload.write_bytes(0, 1);
            let message = &mut *payload;
            write(message);
            let header = message.header_mut();
            (header.sequence, header.producer) = (sequence, producer);
            sample.assume_init()
        };
        let sent = sample.send().is_ok();
        for bell in &self.bells {
            let _ = bell.notify();
        }
        sent
    }
}

/// Messages of several megabytes. They consist of numbers and arrays of numbers alone.
trait Numbers {}
impl Numbers for Weights {}
impl Numbers for Frame {}

impl Publisher<Weights> {
    /// Publishes a policy file. Returns whether it went out; it does not when it is
    /// over [`WEIGHTS_BYTES_MAX`] or shared memory is exhausted.
    pub fn offer(&mut self, version: u64, sha256: [u8; 32], file: &[u8]) -> bool {
        file.len() <= WEIGHTS_BYTES_MAX
            && self.send_written(|weights| {
                weights.version = version;
                weights.byte_count = file.len() as u64;
                weights.sha256 = sha256;
                weights.bytes[..file.len()].copy_from_slice(file);
            })
    }
}

impl Publisher<Frame> {
    /// Publishes a picture of that width, pixels row by row from the top, in three bytes a
    /// pixel. Returns whether it went out; it does not when it is over
    /// [`FRAME_BYTES_MAX`] or shared memory is exhausted.
    pub fn show(&mut self, header: Header, camera: Camera, width: u32, rgb: &[u8]) -> bool {
        let row_bytes = width as usize * 3;
        row_bytes > 0
            && rgb.len() <= FRAME_BYTES_MAX
            && rgb.len().is_multiple_of(row_bytes)
            && self.send_written(|frame| {
                (frame.header, frame.camera) = (header, camera);
                (frame.width, frame.height) = (width, (rgb.len() / row_bytes) as u32);
                frame.format = PixelFormat::Rgb8.code();
                frame.pixels[..rgb.len()].copy_from_slice(rgb);
            })
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use rustix::mm::{MapFlags, ProtFlags, mmap, munmap};

    use super::*;

    /// A file that ends before the mapping does has no memory there, as a full file system
    /// has none.
    #[test]
    fn missing_memory_is_an_error_and_not_a_death() {
        let page = rustix::param::page_size();
        let mut file = tempfile::tempfile().expect("a file");
        file.write_all(&vec![7; page]).expect("a page");
        let access = ProtFlags::READ | ProtFlags::WRITE;
        // SAFETY: a new mapping, of which only the first page is accessed.
        #[allow(unsafe_code)]
        unsafe {
            let mapped = mmap(
                ptr::null_mut(),
                2 * page,
                access,
                MapFlags::SHARED,
                &file,
                0,
            )
            .expect("a mapping");
            let first = mapped.cast::<u8>();
            match populate(first.add(page - 64), 64) {
                Err(Errno::INVAL) => println!("skipped: this kernel is older than 5.14"),
                whole => {
                    assert_eq!(whole, Ok(()));
                    assert_eq!(populate(first.add(page - 32), 64), Err(Errno::FAULT));
                    assert_eq!(*first.add(page - 1), 7, "no byte has changed");
                }
            }
            munmap(mapped, 2 * page).expect("unmapped");
        }
    }
}
