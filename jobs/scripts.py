"""The state machine itself: compare-and-set scripts that Redis runs whole or not at all.

Every change of state publishes its event in the same script, so none is lost. A write by a worker
passes its attempt number, and is refused unless the record still has it: a worker that lost its
job can waste time, never change a result. Time is the clock of Redis.
"""

from jobs.keys import (
    COUNTERS,
    EVENTS_KEPT,
    EVENTS_LIFE_S,
    IDEMPOTENCY_LIFE_S,
    RECORD_MARGIN_S,
    UNFINISHED_OF,
    WEBHOOKS,
)

# KEYS 1..7 and ARGV 1 are the same in every script.
_PRELUDE = f"""
local JOB, EVENTS, INDEX, QUEUED, LEASES, EXPIRING, UNSAVED = unpack(KEYS)
local ID, COUNTERS = ARGV[1], '{COUNTERS}'

local function now()
  local time = redis.call('TIME')
  return tonumber(time[1]) + tonumber(time[2]) / 1e6
end

local function stamp(seconds) return string.format('%.6f', seconds) end

local function emit(kind, data)
  redis.call('XADD', EVENTS, 'MAXLEN', '~', {EVENTS_KEPT}, '*',
             'type', kind, 'time', stamp(now()), 'data', data)
end

local function emit_state(kind, state, attempt, failure)
  local data = {{state = state, attempt = tonumber(attempt)}}
  if failure ~= '' then data.error = cjson.decode(failure) end
  emit(kind, cjson.encode(data))
end

local function announce(state)
  local address = redis.call('HGET', JOB, 'webhook')
  if address and address ~= '' then
    redis.call('ZADD', '{WEBHOOKS}', stamp(now()), ID .. ':' .. state)
  end
end

local function leave_caller()
  local caller = redis.call('HGET', JOB, 'caller')
  if caller and caller ~= '' then redis.call('SREM', '{UNFINISHED_OF}' .. caller, ID) end
end

local function state_of(attempt)
  local found = redis.call('HMGET', JOB, 'state', 'attempt')
  if found[2] ~= attempt then return nil end
  return found[1]
end

local function is_held(state) return state == 'running' or state == 'canceling' end

local function end_as(state, attempt, failure)
  local time = now()
  local kept = tonumber(redis.call('HGET', JOB, 'ttl_s'))
  redis.call('HSET', JOB, 'state', state, 'error', failure, 'eta_s', '',
             'finished_at', stamp(time), 'expires_at', stamp(time + kept))
  redis.call('ZREM', QUEUED, ID)
  redis.call('ZREM', LEASES, ID)
  redis.call('ZADD', EXPIRING, stamp(time + kept), ID)
  redis.call('SADD', UNSAVED, ID)
  emit_state('state', state, attempt, failure)
  emit_state('end', state, attempt, failure)
  announce(state)
  leave_caller()
  redis.call('HINCRBY', COUNTERS, 'jobs:' .. state, 1)
  redis.call('EXPIRE', EVENTS, {EVENTS_LIFE_S})
  redis.call('EXPIRE', JOB, math.ceil(kept) + {RECORD_MARGIN_S})
end
"""

# KEYS 8: idempotency. ARGV: id, body digest or '', most queued or '', created_at, most unfinished
# of the same caller or '', field, value...
CREATE = (
    _PRELUDE
    + f"""
local digest, limit = ARGV[2], tonumber(ARGV[3])
if digest ~= '' then
  local seen = redis.call('GET', KEYS[8])
  if seen then
    local known, other = string.match(seen, '^(%x+) (.+)$')
    if known ~= digest then return {{'conflict', other}} end
    return {{'replayed', other}}
  end
end
if redis.call('EXISTS', JOB) == 1 then return {{'replayed', ID}} end
if limit and redis.call('ZCARD', QUEUED) >= limit then return {{'full', ID}} end
redis.call('HSET', JOB, unpack(ARGV, 6))
local caller = redis.call('HGET', JOB, 'caller')
if caller and caller ~= '' then
  local most = tonumber(ARGV[5])
  if most and redis.call('SCARD', '{UNFINISHED_OF}' .. caller) >= most then
    redis.call('DEL', JOB)
    return {{'many', ID}}
  end
  redis.call('SADD', '{UNFINISHED_OF}' .. caller, ID)
end
redis.call('ZADD', INDEX, 0, ID)
redis.call('ZADD', QUEUED, ARGV[4], ID)
emit_state('state', 'queued', redis.call('HGET', JOB, 'attempt'), '')
if digest ~= '' then
  redis.call('SET', KEYS[8], digest .. ' ' .. ID, 'EX', {IDEMPOTENCY_LIFE_S})
end
return {{'created', ID}}
"""
)

# ARGV: id, attempt, owner, lease seconds, device. Twice by the same owner is once.
CLAIM = (
    _PRELUDE
    + """
local state = state_of(ARGV[2])
if state == 'running' and redis.call('HGET', JOB, 'owner') == ARGV[3] then return 1 end
if state ~= 'queued' then return 0 end
local time = now()
local lease = stamp(time + tonumber(ARGV[4]))
redis.call('HSET', JOB, 'state', 'running', 'owner', ARGV[3], 'device', ARGV[5],
           'started_at', stamp(time), 'lease_until', lease)
redis.call('ZREM', QUEUED, ID)
redis.call('ZADD', LEASES, lease, ID)
emit_state('state', 'running', ARGV[2], '')
announce('running')
return 1
"""
)

# ARGV: id, attempt, event type or '', event data, field, value...
UPDATE = (
    _PRELUDE
    + """
if not is_held(state_of(ARGV[2])) then return 0 end
if #ARGV > 4 then redis.call('HSET', JOB, unpack(ARGV, 5)) end
if ARGV[3] ~= '' then emit(ARGV[3], ARGV[4]) end
return 1
"""
)

# ARGV: id, attempt, lease seconds
RENEW = (
    _PRELUDE
    + """
if not is_held(state_of(ARGV[2])) then return 0 end
local lease = stamp(now() + tonumber(ARGV[3]))
redis.call('HSET', JOB, 'lease_until', lease)
redis.call('ZADD', LEASES, lease, ID)
return 1
"""
)

# ARGV: id, keep what is fitted so far 0/1. Asking again without keeping gives it up.
CANCEL = (
    _PRELUDE
    + """
local found = redis.call('HMGET', JOB, 'state', 'attempt', 'keep_partial')
local state, attempt = found[1], found[2]
if state == 'canceling' and found[3] == '1' and ARGV[2] == '0' then
  redis.call('HSET', JOB, 'keep_partial', '0', 'cancel_requested_at', stamp(now()))
  return 1
end
if state ~= 'queued' and state ~= 'running' then return 0 end
redis.call('HSET', JOB, 'cancel_requested', '1', 'cancel_requested_at', stamp(now()),
           'keep_partial', ARGV[2])
if state == 'queued' then
  end_as('canceled', attempt, '')
else
  redis.call('HSET', JOB, 'state', 'canceling')
  emit_state('state', 'canceling', attempt, '')
end
return 1
"""
)

# ARGV: id, attempt, state, error, outputs, warnings. An acknowledged cancel always wins; the same
# attempt asking again (its first answer was lost) hears the state that was reached.
FINISH = (
    _PRELUDE
    + """
local state = state_of(ARGV[2])
if not state then return false end
if redis.call('HGET', JOB, 'finished_by') == ARGV[2] then return state end
if not is_held(state) then return false end
redis.call('HSET', JOB, 'finished_by', ARGV[2])
if state == 'canceling' then
  if redis.call('HGET', JOB, 'keep_partial') == '1' and ARGV[5] ~= '{}' then
    redis.call('HSET', JOB, 'outputs', ARGV[5], 'warnings', ARGV[6])
  end
  end_as('canceled', ARGV[2], '')
  return 'canceled'
end
redis.call('HSET', JOB, 'warnings', ARGV[6])
if ARGV[3] == 'succeeded' then redis.call('HSET', JOB, 'outputs', ARGV[5], 'progress', '1') end
end_as(ARGV[3], ARGV[2], ARGV[4])
return ARGV[3]
"""
)

# ARGV: id, attempt, crashed 0/1, only when the lease is over 0/1, most crashes, why, poison error
REQUEUE = (
    _PRELUDE
    + """
local state = state_of(ARGV[2])
if state ~= 'queued' and not is_held(state) then return 0 end
local known = redis.call('HMGET', JOB, 'lease_until', 'crashes', 'created_at')
if ARGV[4] == '1' and (state == 'queued' or tonumber(known[1]) >= now()) then return 0 end
if state == 'canceling' then
  end_as('canceled', ARGV[2], '')
  return 1
end
local crashes = tonumber(known[2]) + tonumber(ARGV[3])
redis.call('HINCRBY', COUNTERS, 'workers:lost', ARGV[3])
redis.call('HSET', JOB, 'crashes', crashes)
if crashes >= tonumber(ARGV[5]) then
  end_as('failed', ARGV[2], ARGV[7])
  return 1
end
local attempt = tonumber(ARGV[2]) + 1
redis.call('HSET', JOB, 'state', 'queued', 'attempt', attempt, 'owner', '', 'stage', '',
           'progress', '0', 'eta_s', '', 'points', '', 'round', '0', 'rounds', '0', 'loss', '')
redis.call('ZREM', LEASES, ID)
redis.call('ZADD', QUEUED, known[3], ID)
emit('warning', cjson.encode({message = ARGV[6], attempt = attempt}))
emit_state('state', 'queued', attempt, '')
return 1
"""
)

# ARGV: id, longest wait in seconds, error
EXPIRE = (
    _PRELUDE
    + """
local found = redis.call('HMGET', JOB, 'state', 'created_at', 'attempt')
if found[1] ~= 'queued' or tonumber(found[2]) + tonumber(ARGV[2]) > now() then return 0 end
end_as('expired', found[3], ARGV[3])
return 1
"""
)

# KEYS 8: tombstone. ARGV: id, tombstone seconds, force 0/1
DELETE = (
    _PRELUDE
    + """
local state = redis.call('HGET', JOB, 'state')
if state and ARGV[3] == '0' and (state == 'queued' or is_held(state)) then return 0 end
if state then redis.call('SET', KEYS[8], '1', 'EX', ARGV[2]) end
leave_caller()
redis.call('DEL', JOB, EVENTS)
redis.call('SREM', UNSAVED, ID)
for _, set in ipairs({INDEX, QUEUED, LEASES, EXPIRING}) do redis.call('ZREM', set, ID) end
return 1
"""
)

# ARGV: id, state, attempt, error, expires_at, field, value... An ended job, forgotten by Redis.
RESTORE = (
    _PRELUDE
    + f"""
if redis.call('EXISTS', JOB) == 1 then return 0 end
redis.call('HSET', JOB, unpack(ARGV, 6))
redis.call('ZADD', INDEX, 0, ID)
redis.call('ZADD', EXPIRING, ARGV[5], ID)
emit_state('state', ARGV[2], ARGV[3], ARGV[4])
emit_state('end', ARGV[2], ARGV[3], ARGV[4])
redis.call('EXPIRE', EVENTS, {EVENTS_LIFE_S})
redis.call('EXPIREAT', JOB, math.ceil(tonumber(ARGV[5])) + {RECORD_MARGIN_S})
return 1
"""
)

# ARGV: none. KEYS 1: leases. The ids whose lease is over.
EXPIRED_LEASES = """
local time = redis.call('TIME')
local seconds = string.format('%.6f', tonumber(time[1]) + tonumber(time[2]) / 1e6)
return redis.call('ZRANGEBYSCORE', KEYS[1], '-inf', '(' .. seconds)
"""
