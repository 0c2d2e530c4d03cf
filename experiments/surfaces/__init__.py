"""Whether knowing a real floor helps: DART's car on three floors."""
