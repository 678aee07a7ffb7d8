//! Parameters in the flash's sectors 2 and 3, which the program leaves out.

use lobelia_firmware::storage::Storage;
use stm32f4xx_hal::flash::FlashExt;
use stm32f4xx_hal::pac;

const FIRST_SECTOR: u8 = 2;
const FIRST_OFFSET: usize = 32 * 1024;
const SECTOR: usize = 16 * 1024;

/// The two sectors. The processor waits while one is erased (0.4 s, 0.8 s at most), since the program is in
/// the same flash.
pub(crate) struct FlashSlots(pub(crate) pac::FLASH);

impl FlashSlots {
    /// Makes the processor read anew what its cache has of the flash from before it was written.
    fn forget_cache(&mut self) {
        let cache = self.0.acr();
        cache.modify(|_, w| w.dcen().clear_bit());
        cache.modify(|_, w| w.dcrst().set_bit());
        cache.modify(|_, w| w.dcrst().clear_bit().dcen().set_bit());
    }
}

impl Storage for FlashSlots {
    fn read(&mut self, slot: usize, into: &mut [u8]) -> bool {
        let begin = FIRST_OFFSET + slot * SECTOR;
        let Some(bytes) = self.0.read().get(begin..begin + into.len()) else { return false };
        into.copy_from_slice(bytes);
        true
    }

    fn erase(&mut self, slot: usize) -> bool {
        let erased = self.0.unlocked().erase(FIRST_SECTOR + slot as u8).is_ok();
        self.forget_cache();
        erased
    }

    fn write(&mut self, slot: usize, bytes: &[u8]) -> bool {
        let written = self.0.unlocked().program(FIRST_OFFSET + slot * SECTOR, bytes.iter()).is_ok();
        self.forget_cache();
        written
    }
}
