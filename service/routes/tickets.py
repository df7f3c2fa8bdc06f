"""Tickets for websockets: browsers cannot send a header with their handshake."""

from __future__ import annotations

from fastapi import APIRouter

from service.callers import current
from service.keys import TICKET_LIFE_S
from service.openapi import problems
from service.schemas import Ticket
from service.services import Needs

router = APIRouter(prefix="/v1/tickets", tags=["system"])


@router.post(
    "",
    operation_id="createTicket",
    summary="A one-time ticket for a websocket",
    status_code=201,
    responses=problems(401, 503),
)
async def create_ticket(services: Needs) -> Ticket:
    """Open the websocket with `?ticket=` within half a minute; the key stays out of addresses."""
    ticket = await services.keys.ticket_for(current())
    return Ticket(ticket=ticket, expires_in_s=TICKET_LIFE_S)
